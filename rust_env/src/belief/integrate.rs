//! Putting an image into the map: OctoMap's `insertPointCloud`, voxel for voxel and bit for bit.
//!
//! Exact integration (the default): every pixel's ray is walked, each voxel is updated once per image, and hits
//! beat misses. The rays of an image first mark voxels in a frame around them (no map access, no allocation once
//! warm), then every touched brick is updated once. Rays are walked in lockstep where the machine can
//! ([`super::lockstep`]), one by one elsewhere and for images that span very much space.
use super::lockstep::{self, Lanes, FREE, MAX_WINDOW};
use super::octree::{BrickUpdate, Octree, SIDE, VOXELS};
use super::ray_walk::Dda;
use super::uncertainty::{self, UncertaintyModel};
use crate::camera::{Camera, DepthKind};
use crate::error::{Error, Result};
use crate::geometry::{IVec3, Pose, Vec3};

const NONE: u32 = u32::MAX;
/// Largest number of bricks that one image's box may span (a u32 each).
const MAX_FRAME_CELLS: u64 = 1 << 27;

/// A measured ray: where it ends, and whether something was hit there.
#[derive(Clone, Copy)]
struct Ray {
    end: Vec3,
    key: IVec3,
    hit: bool,
    uncertainty: f32,
}

/// What one image saw of one brick.
#[derive(Clone)]
struct FrameBrick {
    free: [u64; 8],
    hit: [u64; 8],
    uncertainty: u32,
}

/// The memory of an integration, kept from image to image.
#[derive(Clone)]
pub struct Integrator {
    lanes: Lanes,
    rays: Vec<Ray>,
    /// Corner and size of the frame, in bricks.
    origin: IVec3,
    dims: IVec3,
    /// Number of the frame brick of each cell of the frame.
    slots: Vec<u32>,
    bricks: Vec<FrameBrick>,
    uncertainty: Vec<[f32; VOXELS]>,
    /// For lockstep: a byte per voxel of the frame, and the rays' ends.
    window: Vec<u8>,
    ends: lockstep::Rays,
    optics: Optics,
    /// Cell of the frame, its free voxels, its frame brick.
    updates: Vec<(IVec3, [u64; 8], u32)>,
}

impl Default for Integrator {
    fn default() -> Self {
        Self::with_lanes(Lanes::best())
    }
}

/// What depends on the pixel alone, computed once per camera.
#[derive(Clone, Default)]
struct Optics {
    camera: Option<(Camera, UncertaintyModel)>,
    /// Ray directions with z = 1 and their lengths.
    rays: Vec<(Vec3, f32)>,
    /// Lluvia 2023, Eq. 7.
    angle: Vec<f32>,
}

impl Optics {
    fn prepare(&mut self, camera: &Camera, model: &UncertaintyModel) {
        if self
            .camera
            .as_ref()
            .is_some_and(|(c, m)| c == camera && m == model)
        {
            return;
        }
        let pixels =
            (0..camera.height).flat_map(|v| (0..camera.width).map(move |u| camera.ray(u, v)));
        self.rays = pixels.map(|r| (r, r.length())).collect();
        self.angle = model.angle_table(camera);
        self.camera = Some((camera.clone(), *model));
    }
}

impl Integrator {
    /// An integrator that walks its rays in a given way; all ways give the same map.
    pub fn with_lanes(lanes: Lanes) -> Self {
        Self {
            lanes,
            rays: Vec::new(),
            origin: IVec3::ZERO,
            dims: IVec3::ZERO,
            slots: Vec::new(),
            bricks: Vec::new(),
            uncertainty: Vec::new(),
            window: Vec::new(),
            ends: lockstep::Rays::default(),
            optics: Optics::default(),
            updates: Vec::new(),
        }
    }

    /// Insert a depth image (row-major, `camera.width * camera.height` values) taken from `world_from_camera`.
    /// NaN, negative and zero depths are no measurement; +inf is a ray that met nothing within `max_range`
    /// (default: the camera's `far`), which frees space up to there. `max_range` is a range along the ray.
    pub fn insert_depth(
        &mut self,
        octree: &mut Octree,
        depth: &[f32],
        camera: &Camera,
        world_from_camera: &Pose,
        max_range: Option<f64>,
        model: &UncertaintyModel,
    ) -> Result<()> {
        if depth.len() != camera.pixels() {
            return Err(Error::invalid(format!(
                "depth has {} values, the camera {} x {} pixels",
                depth.len(),
                camera.height,
                camera.width
            )));
        }
        let max_range = max_range.unwrap_or(f64::from(camera.far));
        self.begin(octree, world_from_camera.translation)?;
        let mut optics = std::mem::take(&mut self.optics);
        optics.prepare(camera, model);
        let origin = world_from_camera.translation;
        let beyond = (2.0 * max_range) as f32;
        for ((d, (ray, length)), angle) in depth.iter().zip(&optics.rays).zip(&optics.angle) {
            // NaN is no measurement either.
            if d.is_nan() || *d <= 0.0 {
                continue;
            }
            let scale = match camera.kind {
                _ if d.is_infinite() => beyond / length,
                DepthKind::Range => d / length,
                DepthKind::Z => *d,
            };
            let point = world_from_camera.point(*ray * scale);
            self.add(octree, origin, point, max_range, || {
                model.of_parts(*angle, scale * length)
            });
        }
        self.optics = optics;
        self.finish(octree, world_from_camera.translation)
    }

    /// Insert points (world frame) seen from `origin`. Points beyond `max_range` free space up to there;
    /// without a camera the uncertainty is that of the distance alone (Lluvia 2023, Eq. 2).
    pub fn insert_points(
        &mut self,
        octree: &mut Octree,
        points: impl IntoIterator<Item = Vec3>,
        origin: Vec3,
        max_range: Option<f64>,
    ) -> Result<()> {
        if let Some(r) = max_range {
            crate::error::positive("max_range", r)?;
        }
        self.begin(octree, origin)?;
        let max_range = max_range.unwrap_or(f64::INFINITY);
        for p in points {
            self.add(octree, origin, p, max_range, || {
                uncertainty::of_distance((p - origin).length(), UncertaintyModel::FOCAL_DISTANCE)
            });
        }
        self.finish(octree, origin)
    }

    fn begin(&mut self, octree: &Octree, origin: Vec3) -> Result<()> {
        self.rays.clear();
        match octree.key(origin) {
            Some(_) => Ok(()),
            None => Err(Error::invalid(format!(
                "the sensor's position {origin} is not finite or outside the map's key space of +-{} m",
                octree.resolution() * f64::from(super::octree::KEY_LIMIT)
            ))),
        }
    }

    /// OctoMap's `computeUpdate`, one point of it, in its arithmetic (f32 vectors, f64 norms).
    #[inline]
    fn add(
        &mut self,
        octree: &Octree,
        origin: Vec3,
        point: Vec3,
        max_range: f64,
        uncertainty: impl FnOnce() -> f32,
    ) {
        let difference = point - origin;
        let norm = norm(difference);
        let hit = norm <= max_range;
        let end = if hit {
            point
        } else {
            let length = norm as f32;
            let direction = Vec3::new(
                difference.x / length,
                difference.y / length,
                difference.z / length,
            );
            origin + direction * (max_range as f32)
        };
        if let Some(key) = octree.key(end) {
            let uncertainty = if hit { uncertainty() } else { 1.0 };
            self.rays.push(Ray {
                end,
                key,
                hit,
                uncertainty,
            });
        }
    }

    fn finish(&mut self, octree: &mut Octree, origin: Vec3) -> Result<()> {
        let Some(start) = octree.key(origin) else {
            return Ok(());
        };
        let cells = self.frame(start)?;
        if self.lanes == Lanes::Scalar || cells * VOXELS as u64 >= MAX_WINDOW {
            self.trace(octree.resolution(), origin, start);
        } else {
            self.trace_in_lockstep(octree.resolution(), origin, start);
        }
        self.hits();
        self.apply(octree)
    }

    /// Lay the frame over all rays. The walk may leave the box of a ray's ends by rounding: two voxels to spare.
    /// Returns its number of cells.
    fn frame(&mut self, start: IVec3) -> Result<u64> {
        let (mut low, mut high) = (start, start);
        for ray in &self.rays {
            low = low.min(ray.key);
            high = high.max(ray.key);
        }
        self.origin = (low - 2) >> 3;
        self.dims = ((high + 2) >> 3) - self.origin + 1;
        let volume = self.dims.x as u64 * self.dims.y as u64 * self.dims.z as u64;
        if volume > MAX_FRAME_CELLS {
            return Err(Error::invalid(format!(
                "the image spans {} x {} x {} voxels; pass a max_range or use a coarser resolution",
                self.dims.x * SIDE,
                self.dims.y * SIDE,
                self.dims.z * SIDE
            )));
        }
        self.slots.clear();
        self.slots.resize(volume as usize, NONE);
        self.bricks.clear();
        self.uncertainty.clear();
        self.window.clear();
        Ok(volume)
    }

    /// Number of a voxel in the window: rows of x, then y, then z.
    fn window_cell(&self, key: IVec3) -> i32 {
        let k = key - self.origin * SIDE;
        (k.z * self.dims.y * SIDE + k.y) * self.dims.x * SIDE + k.x
    }

    fn trace_in_lockstep(&mut self, resolution: f64, origin: Vec3, start: IVec3) {
        let voxels = self.dims * SIDE;
        self.ends.clear();
        for i in 0..self.rays.len() {
            let ray = self.rays[i];
            let cell = self.window_cell(ray.key);
            self.ends.push(ray.end, cell);
        }
        // One byte more for what must not be marked.
        self.window
            .resize((voxels.x * voxels.y * voxels.z) as usize + 1, 0);
        let frame = lockstep::Frame {
            resolution,
            origin,
            start,
            start_cell: self.window_cell(start),
            strides: [1, voxels.x, voxels.x * voxels.y],
        };
        lockstep::trace(self.lanes, &frame, &self.ends, &mut self.window);
    }

    /// The marked voxels of the frame's cell `c` in the window, as a brick's words.
    fn marked(&self, c: IVec3) -> [u64; 8] {
        let mut words = [0; 8];
        if self.window.is_empty() {
            return words;
        }
        let (row, layer) = (
            (self.dims.x * SIDE) as usize,
            (self.dims.x * self.dims.y * SIDE * SIDE) as usize,
        );
        let corner =
            (c.z * SIDE) as usize * layer + (c.y * SIDE) as usize * row + (c.x * SIDE) as usize;
        for (z, word) in words.iter_mut().enumerate() {
            for y in 0..8 {
                let at = corner + z * layer + y * row;
                if let Some(bytes) = self
                    .window
                    .get(at..at + 8)
                    .and_then(|b| <[u8; 8]>::try_from(b).ok())
                {
                    // Gathers the lowest bits of eight bytes into one byte.
                    let bits = u64::from_le_bytes(bytes)
                        .wrapping_mul(0x0102_0408_1020_4080 * u64::from(FREE))
                        >> 56;
                    *word |= bits << (y * 8);
                }
            }
        }
        words
    }

    #[inline]
    fn slot(&mut self, brick: IVec3) -> Option<usize> {
        let c = brick - self.origin;
        let d = self.dims;
        if !((c.x as u32) < d.x as u32 && (c.y as u32) < d.y as u32 && (c.z as u32) < d.z as u32) {
            return None;
        }
        let cell = ((c.z as usize * d.y as usize) + c.y as usize) * d.x as usize + c.x as usize;
        if self.slots[cell] == NONE {
            self.slots[cell] = self.bricks.len() as u32;
            self.bricks.push(FrameBrick {
                free: [0; 8],
                hit: [0; 8],
                uncertainty: NONE,
            });
        }
        Some(self.slots[cell] as usize)
    }

    /// OctoMap's `computeRayKeys` for every ray: all voxels from the sensor's up to, not including, the last.
    fn trace(&mut self, resolution: f64, origin: Vec3, start: IVec3) {
        let rays = std::mem::take(&mut self.rays);
        for ray in &rays {
            if ray.key == start {
                continue;
            }
            let difference = ray.end - origin;
            let length = norm(difference) as f32;
            let direction = Vec3::new(
                difference.x / length,
                difference.y / length,
                difference.z / length,
            );
            let mut dda = Dda::new(resolution, start, origin, direction);
            let length = f64::from(length);
            'walk: loop {
                let corner = dda.key >> 3;
                let Some(slot) = self.slot(corner) else {
                    break;
                };
                let free = &mut self.bricks[slot].free;
                while dda.key >> 3 == corner {
                    free[(dda.key.z & 7) as usize] |= 1 << ((dda.key.y & 7) << 3 | (dda.key.x & 7));
                    dda.advance();
                    if dda.key == ray.key || dda.exit() > length {
                        break 'walk;
                    }
                }
            }
        }
        self.rays = rays;
    }

    fn hits(&mut self) {
        let rays = std::mem::take(&mut self.rays);
        for ray in rays.iter().filter(|r| r.hit) {
            let Some(slot) = self.slot(ray.key >> 3) else {
                continue;
            };
            let voxel = super::octree::voxel_in_brick(ray.key);
            let brick = &mut self.bricks[slot];
            brick.hit[voxel >> 6] |= 1 << (voxel & 63);
            if brick.uncertainty == NONE {
                brick.uncertainty = self.uncertainty.len() as u32;
                self.uncertainty.push([1.0; VOXELS]);
            }
            let u = &mut self.uncertainty[brick.uncertainty as usize][voxel];
            *u = u.min(ray.uncertainty);
        }
        self.rays = rays;
    }

    /// In the order of the frame's cells, so that the map does not depend on the order of the rays.
    fn apply(&mut self, octree: &mut Octree) -> Result<()> {
        let (mut low, mut high) = (IVec3::ZERO, self.dims - 1);
        if let Some(limits) = octree.limits() {
            low = low.max((limits.min >> 3) - self.origin);
            high = high.min(((limits.max - 1) >> 3) - self.origin);
        }
        let mut updates = std::mem::take(&mut self.updates);
        updates.clear();
        let (mut reserve_low, mut reserve_high) = (IVec3::MAX, IVec3::MIN);
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                for x in low.x..=high.x {
                    let c = IVec3::new(x, y, z);
                    let slot = self.slots[((z * self.dims.y + y) * self.dims.x + x) as usize];
                    let mut free = self.marked(c);
                    if slot != NONE {
                        let brick = &self.bricks[slot as usize];
                        free.iter_mut().zip(&brick.free).for_each(|(a, b)| *a |= b);
                    } else if free == [0; 8] {
                        continue;
                    }
                    reserve_low = reserve_low.min(c);
                    reserve_high = reserve_high.max(c);
                    updates.push((c, free, slot));
                }
            }
        }
        if !updates.is_empty() {
            octree.reserve(self.origin + reserve_low, self.origin + reserve_high)?;
        }
        for (c, free, slot) in &updates {
            let brick = self.bricks.get(*slot as usize);
            octree.apply(&BrickUpdate {
                brick: self.origin + *c,
                free: *free,
                hit: brick.map_or([0; 8], |b| b.hit),
                uncertainty: brick.and_then(|b| self.uncertainty.get(b.uncertainty as usize)),
            });
        }
        self.updates = updates;
        Ok(())
    }
}

/// OctoMap's `Vector3::norm`: the sum of squares in f32, the root in f64.
#[inline]
fn norm(v: Vec3) -> f64 {
    f64::from(v.x * v.x + v.y * v.y + v.z * v.z).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::belief::octree::{SensorModel, State};
    use crate::geometry::Aabb;
    use proptest::prelude::*;

    fn points() -> impl Strategy<Value = Vec<Vec3>> {
        let coordinate = -6.0f32..6.0;
        prop::collection::vec(
            (coordinate.clone(), coordinate.clone(), coordinate).prop_map(Vec3::from),
            0..200,
        )
    }

    fn map_of(
        lanes: Lanes,
        clouds: &[(Vec3, Vec<Vec3>)],
        max_range: Option<f64>,
        bounds: Option<Aabb>,
    ) -> Octree {
        let mut octree = Octree::new(0.1, SensorModel::default()).unwrap();
        if let Some(bounds) = bounds {
            octree = octree.limited_to(&bounds).unwrap();
        }
        let mut integrator = Integrator::with_lanes(lanes);
        for (origin, cloud) in clouds {
            integrator
                .insert_points(&mut octree, cloud.iter().copied(), *origin, max_range)
                .unwrap();
        }
        octree
    }

    fn contents(octree: &Octree) -> Vec<(IVec3, u32, u32)> {
        let mut keys = octree.keys(State::Occupied);
        keys.extend(octree.keys(State::Free));
        keys.iter()
            .map(|k| {
                (
                    *k,
                    octree.log_odds(*k).unwrap().to_bits(),
                    octree.uncertainty(*k).to_bits(),
                )
            })
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn every_kind_of_walk_gives_the_same_map(
            clouds in prop::collection::vec(((-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0).prop_map(Vec3::from), points()), 1..4),
            range in prop::option::of(0.5f64..8.0),
            limited in any::<bool>(),
        ) {
            let bounds = limited.then(|| Aabb::new(Vec3::new(-2.03, -1.0, -3.3), Vec3::new(2.9, 4.0, 1.71)));
            let scalar = map_of(Lanes::Scalar, &clouds, range, bounds);
            let counts = (scalar.num_known(), scalar.num_occupied(), scalar.entropy(), scalar.information());
            prop_assert_eq!(scalar.recount(), counts);
            for lanes in Lanes::available() {
                prop_assert_eq!(contents(&map_of(lanes, &clouds, range, bounds)), contents(&scalar), "{:?}", lanes);
            }
        }

        #[test]
        fn bounds_only_leave_voxels_out(cloud in points()) {
            let bounds = Aabb::new(Vec3::new(-1.05, -2.0, -1.5), Vec3::new(1.5, 0.33, 3.0));
            let cloud = vec![(Vec3::splat(0.05), cloud)];
            let all = map_of(Lanes::detect(), &cloud, Some(4.0), None);
            let limited = map_of(Lanes::detect(), &cloud, Some(4.0), Some(bounds));
            let limits = limited.limits().unwrap();
            let mut expected: Vec<_> = contents(&all).into_iter().filter(|c| limits.contains(c.0)).collect();
            let mut found = contents(&limited);
            expected.sort_by_key(|c| c.0.to_array());
            found.sort_by_key(|c| c.0.to_array());
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn hits_beat_misses_and_each_voxel_counts_once() {
        // The second ray passes through the voxel in which the first ends.
        let cloud = vec![
            Vec3::new(0.55, 0.05, 0.05),
            Vec3::new(1.05, 0.06, 0.05),
            Vec3::new(1.06, 0.05, 0.05),
        ];
        let octree = map_of(Lanes::detect(), &[(Vec3::splat(0.05), cloud)], None, None);
        let sensor = SensorModel::default();
        assert_eq!(octree.log_odds(IVec3::new(5, 0, 0)), Some(sensor.hit));
        assert_eq!(octree.log_odds(IVec3::new(10, 0, 0)), Some(sensor.hit));
        for x in [0, 1, 2, 3, 4, 6, 7, 8, 9] {
            assert_eq!(
                octree.log_odds(IVec3::new(x, 0, 0)),
                Some(sensor.miss),
                "voxel {x}"
            );
        }
        assert_eq!(octree.num_known(), 11);
    }

    #[test]
    fn a_wide_image_takes_the_scalar_path_and_a_wider_one_is_refused() {
        let far = vec![Vec3::new(60.0, 60.0, 60.0)];
        let octree = map_of(
            Lanes::detect(),
            &[(Vec3::splat(0.05), far.clone())],
            None,
            None,
        );
        assert_eq!(octree.num_occupied(), 1);
        let mut octree = Octree::new(0.1, SensorModel::default()).unwrap();
        let far = [Vec3::splat(3000.0)];
        assert!(Integrator::default()
            .insert_points(&mut octree, far, Vec3::splat(-3000.0), None)
            .is_err());
        assert_eq!(octree.num_known(), 0);
    }
}
