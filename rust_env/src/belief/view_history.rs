//! From where every voxel was seen: the view-dependent descriptors of Wang et al. 2019 (RA-L), section III-A.
//!
//! A voxel k keeps, for each of 36 x 18 directions i in which a sensor was seen from it, the occupancy probability at its last
//! sight from there, `O_k[i] = p_k` (Eq. 1), and the confidence that these sights add up to, `C_k[i] += c(p_k)` (Eq. 2) with
//! `c(p) = 1 + p log2 p + (1 - p) log2(1 - p)` (base 2, so that c(1/2) = 0 and c(0) = c(1) = 1).
//!
//! Sights are sparse: most voxels are seen from a handful of directions, and neighbours from the same ones. So what is
//! stored is one block for each layer of 8 x 8 voxels of a brick and each direction from which some voxel of the layer was
//! seen: 8 bytes a voxel and direction, less than 9 with what leads to them. Confidences are integers: a voxel's sum over
//! all directions is exact, in whatever order it was seen.
use super::octree::{entropy_units, probability, voxel_in_brick, Brick, Octree, SIDE};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::geometry::{Aabb, IVec3, Pose, Vec3};
use sectors::{mask, Sectors};

mod bytes;
pub mod sectors;

/// Directions around the vertical axis and from top to bottom, each pi / 18 wide.
pub const AZIMUTHS: usize = 36;
pub const ELEVATIONS: usize = 18;
/// Voxels of a layer.
pub const LAYER: usize = 64;
/// Unit of confidences: 2^-20, so that 4095 certain sights fit.
pub const UNIT: u32 = 1 << 20;
const NONE: u32 = u32::MAX;

/// The confidence c(p) of Eq. 2, in `UNIT`s, of a log-odds value.
#[inline]
pub fn confidence(log_odds: f32) -> u32 {
    // `entropy_units` are 2^-32 bit.
    UNIT - (entropy_units(log_odds) >> 12).min(u64::from(UNIT)) as u32
}

/// That some of a layer's voxels were seen from one direction.
#[derive(Clone)]
pub struct Sight {
    /// Number of the direction: `azimuth * ELEVATIONS + elevation`.
    direction: u16,
    /// The layer's next sight.
    next: u32,
    /// The voxels that were seen from there, and those of them with C_k > 0.
    pub seen: u64,
    pub confident: u64,
}

/// What a layer's voxels looked like from one direction.
#[derive(Clone)]
pub struct Block {
    /// O_k, as log-odds.
    pub log_odds: [f32; LAYER],
    /// C_k, in `UNIT`s.
    pub confidence: [u32; LAYER],
}

/// The sum of C_k over all directions, for a layer's voxels.
#[derive(Clone)]
pub struct Total {
    /// The voxels that were seen from anywhere.
    pub seen: u64,
    /// In `UNIT`s.
    pub confidence: [u32; LAYER],
}

#[derive(Clone, Copy)]
struct Layer {
    total: u32,
    /// First sight.
    head: u32,
}

impl Layer {
    const EMPTY: Layer = Layer {
        total: NONE,
        head: NONE,
    };
}

/// The layer of an octree; its bricks have the octree's numbers.
#[derive(Clone, Default)]
pub struct ViewHistory {
    layers: Vec<[Layer; 8]>,
    totals: Vec<Total>,
    sights: Vec<Sight>,
    /// One for each sight.
    blocks: Vec<Block>,
}

impl ViewHistory {
    pub fn clear(&mut self) {
        self.layers.clear();
        self.totals.clear();
        self.sights.clear();
        self.blocks.clear();
    }

    pub fn memory_bytes(&self) -> usize {
        self.layers.capacity() * std::mem::size_of::<[Layer; 8]>()
            + self.totals.capacity() * std::mem::size_of::<Total>()
            + self.sights.capacity() * std::mem::size_of::<Sight>()
            + self.blocks.capacity() * std::mem::size_of::<Block>()
    }

    fn layer(&self, brick: usize, z: usize) -> Layer {
        self.layers.get(brick).map_or(Layer::EMPTY, |l| l[z])
    }

    /// The sums of layer `z` of a brick; `None` if none of its voxels was ever seen.
    pub fn total(&self, brick: usize, z: usize) -> Option<&Total> {
        self.totals.get(self.layer(brick, z).total as usize)
    }

    /// Ask for what is stored of a brick before it is needed: it stands all over memory.
    #[inline(always)]
    pub fn prefetch(&self, brick: usize) {
        #[cfg(target_arch = "x86_64")]
        for layer in self.layers.get(brick).into_iter().flatten() {
            use std::arch::x86_64::{_mm_prefetch, _MM_HINT_T0};
            let ask = |first: *const u32, bytes: usize| {
                for at in (0..bytes).step_by(64) {
                    // SAFETY: a prefetch reads nothing, wherever it points.
                    unsafe { _mm_prefetch::<_MM_HINT_T0>(first.cast::<i8>().wrapping_add(at)) };
                }
            };
            if let Some(total) = self.totals.get(layer.total as usize) {
                ask(total.confidence.as_ptr(), size_of::<Total>());
            }
            if let Some(block) = self.blocks.get(layer.head as usize) {
                ask(block.log_odds.as_ptr().cast(), 4 * LAYER);
            }
        }
        let _ = brick;
    }

    /// What layer `z` of a brick looked like from a direction; `None` if it was never seen from there.
    #[inline]
    pub fn block(&self, brick: usize, z: usize, direction: usize) -> Option<(&Sight, &Block)> {
        let number = self.find(self.layer(brick, z).head, direction);
        Some((self.sights.get(number)?, self.blocks.get(number)?))
    }

    /// Number of the sight from a direction in a layer whose first is `head`; none has this number if there is none.
    #[inline]
    fn find(&self, head: u32, direction: usize) -> usize {
        let mut number = head as usize;
        while let Some(sight) = self.sights.get(number) {
            if sight.direction as usize == direction {
                break;
            }
            number = sight.next as usize;
        }
        number
    }

    /// The directions from which some voxel of the layer was seen, in no particular order.
    pub fn directions(
        &self,
        brick: usize,
        z: usize,
    ) -> impl Iterator<Item = (usize, &Sight, &Block)> {
        let mut number = self.layer(brick, z).head as usize;
        std::iter::from_fn(move || {
            let (sight, block) = (self.sights.get(number)?, self.blocks.get(number)?);
            number = sight.next as usize;
            Some((sight.direction as usize, sight, block))
        })
    }

    /// Voxels `voxels` of a layer were seen from `direction` with these log-odds (Eq. 1 and 2).
    fn record(
        &mut self,
        brick: usize,
        z: usize,
        direction: usize,
        voxels: u64,
        log_odds: &[f32; LAYER],
        now: &[u32; LAYER],
    ) {
        if self.layers.len() <= brick {
            self.layers.resize(brick + 1, [Layer::EMPTY; 8]);
        }
        let layer = &mut self.layers[brick][z];
        if layer.total == NONE {
            layer.total = self.totals.len() as u32;
            self.totals.push(Total {
                seen: 0,
                confidence: [0; LAYER],
            });
        }
        let Layer { head, total } = *layer;
        let mut number = self.find(head, direction);
        if number >= self.sights.len() {
            number = self.sights.len();
            self.layers[brick][z].head = number as u32;
            self.sights.push(Sight {
                direction: direction as u16,
                next: head,
                seen: 0,
                confident: 0,
            });
            self.blocks.push(Block {
                log_odds: [0.0; LAYER],
                confidence: [0; LAYER],
            });
        }
        let total = &mut self.totals[total as usize];
        let (sight, block) = (&mut self.sights[number], &mut self.blocks[number]);
        total.seen |= voxels;
        sight.seen |= voxels;
        sight.confident |= voxels & mask(|i| now[i] > 0);
        if voxels == u64::MAX {
            block.log_odds = *log_odds;
            let sums = block.confidence.iter_mut().zip(&mut total.confidence);
            for ((here, all), now) in sums.zip(now) {
                *here = here.saturating_add(*now);
                *all = all.saturating_add(*now);
            }
            return;
        }
        let mut bits = voxels;
        while bits != 0 {
            let i = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            block.log_odds[i] = log_odds[i];
            block.confidence[i] = block.confidence[i].saturating_add(now[i]);
            total.confidence[i] = total.confidence[i].saturating_add(now[i]);
        }
    }

    /// Forget what was recorded of a brick's voxels.
    pub fn forget(&mut self, brick: usize, voxels: &[u64; 8]) {
        for (z, mask) in voxels.iter().enumerate() {
            let Layer { total, mut head } = self.layer(brick, z);
            let Some(total) = self.totals.get_mut(total as usize) else {
                continue;
            };
            total.seen &= !mask;
            let each = |i: &usize| mask >> i & 1 == 1;
            (0..LAYER)
                .filter(each)
                .for_each(|i| total.confidence[i] = 0);
            while let Some(sight) = self.sights.get_mut(head as usize) {
                let block = &mut self.blocks[head as usize];
                sight.seen &= !mask;
                sight.confident &= !mask;
                (0..LAYER).filter(each).for_each(|i| {
                    block.confidence[i] = 0;
                    block.log_odds[i] = 0.0;
                });
                head = sight.next;
            }
        }
    }
}

/// What a camera can see without regard to occlusion: the paper's frustum, "by checking distance and angle".
pub struct Frustum {
    origin: Vec3,
    /// Inward normals of the four sides.
    sides: [Vec3; 4],
    near: f32,
    far: f32,
    /// A box around it.
    bounds: Aabb,
}

impl Frustum {
    /// `max_range`: the longest range that the map takes in, metres.
    pub fn new(camera: &Camera, world_from_camera: &Pose, max_range: f32) -> Self {
        let (w, h) = (camera.width as f32, camera.height as f32);
        let far = camera.far.min(max_range);
        let sides = [
            Vec3::new(camera.fx, 0.0, camera.cx),
            Vec3::new(-camera.fx, 0.0, w - camera.cx),
            Vec3::new(0.0, camera.fy, camera.cy),
            Vec3::new(0.0, -camera.fy, h - camera.cy),
        ]
        .map(|n| world_from_camera.rotation * n.normalize());
        let corner = |u: f32, v: f32| {
            let ray = Vec3::new(
                (u - camera.cx) / camera.fx,
                (v - camera.cy) / camera.fy,
                1.0,
            );
            world_from_camera.point(ray * far)
        };
        let corners = [
            corner(0.0, 0.0),
            corner(w, 0.0),
            corner(0.0, h),
            corner(w, h),
        ];
        Self {
            origin: world_from_camera.translation,
            sides,
            near: camera.near,
            far,
            bounds: Aabb::of(corners.into_iter().chain([world_from_camera.translation])),
        }
    }

    /// Is a point inside?
    pub fn contains(&self, point: Vec3) -> bool {
        let d = point - self.origin;
        let range = d.length();
        range >= self.near && range <= self.far && self.sides.iter().all(|n| n.dot(d) >= 0.0)
    }

    pub fn bounds(&self) -> &Aabb {
        &self.bounds
    }

    /// May a ball hold points of the frustum?
    pub fn touches(&self, center: Vec3, radius: f32) -> bool {
        let d = center - self.origin;
        let range = d.length();
        range <= self.far + radius
            && range >= self.near - radius
            && self.sides.iter().all(|n| n.dot(d) >= -radius)
    }

    /// Does it hold the whole ball?
    fn holds(&self, center: Vec3, radius: f32) -> bool {
        let d = center - self.origin;
        let range = d.length();
        range <= self.far - radius
            && range >= self.near + radius
            && self.sides.iter().all(|n| n.dot(d) >= radius)
    }
}

/// The bricks of a map that a frustum touches: number, and the centre of the brick's first voxel.
pub fn bricks_in<'a>(
    octree: &'a Octree,
    frustum: &'a Frustum,
) -> impl Iterator<Item = (usize, &'a Brick, IVec3)> + 'a {
    let root = octree.root();
    let brick = octree.resolution() as f32 * SIDE as f32;
    let low = (frustum.bounds.min / brick).floor().as_ivec3() - 1;
    let high = (frustum.bounds.max / brick).floor().as_ivec3() + 1;
    let low = low.max(root.origin);
    let high = high.min(root.origin + root.dims - 1);
    let radius = brick * 0.5 * 3f32.sqrt();
    let rows = (low.z..=high.z).flat_map(move |z| (low.y..=high.y).map(move |y| (y, z)));
    rows.flat_map(move |(y, z)| (low.x..=high.x).map(move |x| IVec3::new(x, y, z)))
        .filter_map(move |c| {
            let number = root.brick(root.index(c)?)?;
            let center = (c.as_vec3() + 0.5) * brick;
            frustum
                .touches(center, radius)
                .then(|| (number, &octree.bricks()[number], c))
        })
}

impl Octree {
    /// Record that a camera saw, from `world_from_camera`, every known voxel whose centre its frustum holds (Wang 2019,
    /// Eq. 1 and 2: visibility is "distance and angle", occlusion plays no part). To be called after the image itself was
    /// integrated: p_k is the probability with it. Errors: the map keeps no view history.
    pub fn record_view(
        &mut self,
        camera: &Camera,
        world_from_camera: &Pose,
        max_range: f32,
    ) -> Result<()> {
        let Some(mut history) = self.view_history_mut().take() else {
            return Err(Error::invalid("the map keeps no view history"));
        };
        let frustum = Frustum::new(camera, world_from_camera, max_range);
        let resolution = self.resolution() as f32;
        let radius = resolution * SIDE as f32 * 0.5 * 3f32.sqrt();
        let sectors = Sectors::new(frustum.origin);
        for (number, brick, c) in bricks_in(self, &frustum) {
            let first = self.center(c * SIDE);
            let center = first + 3.5 * resolution;
            let whole = frustum.holds(center, radius);
            let column = sectors.column(first, resolution, radius);
            for z in 0..8 {
                let corner = first + Vec3::Z * (z as f32 * resolution);
                let mut voxels = brick.known[z];
                if voxels == 0 {
                    continue;
                }
                if !whole {
                    voxels &= within(&frustum, corner, resolution);
                }
                let log_odds: &[f32; LAYER] = layer_of(&brick.log_odds, z);
                let now = confidences(log_odds);
                for (direction, part) in sectors.split(&column, corner.z, voxels).iter() {
                    history.record(number, z, direction, part, log_odds, &now);
                }
            }
        }
        *self.view_history_mut() = Some(history);
        Ok(())
    }
}

impl Octree {
    /// O_k as probabilities and C_k of the voxels at some points: 36 x 18 values a point each, directions as in
    /// [`Sectors::direction`]. NaN and 0 where the voxel was not seen from the direction.
    pub fn view_history_at(&self, points: &[Vec3]) -> Result<(Vec<f32>, Vec<f32>)> {
        const DIRECTIONS: usize = AZIMUTHS * ELEVATIONS;
        let Some(history) = self.view_history() else {
            return Err(Error::invalid("the map keeps no view history"));
        };
        let mut seen = vec![f32::NAN; points.len() * DIRECTIONS];
        let mut confidence = vec![0.0; points.len() * DIRECTIONS];
        for (i, point) in points.iter().enumerate() {
            let Some(key) = self.key(*point) else {
                continue;
            };
            let cell = self.root().index(key >> 3);
            let Some(brick) = cell.and_then(|c| self.root().brick(c)) else {
                continue;
            };
            let (z, bit) = (voxel_in_brick(key) / LAYER, voxel_in_brick(key) % LAYER);
            for (direction, sight, block) in history.directions(brick, z) {
                if sight.seen >> bit & 1 == 1 {
                    seen[i * DIRECTIONS + direction] = probability(block.log_odds[bit]) as f32;
                    confidence[i * DIRECTIONS + direction] =
                        block.confidence[bit] as f32 / UNIT as f32;
                }
            }
        }
        Ok((seen, confidence))
    }
}

/// Layer `z` of a brick's values.
pub fn layer_of(values: &[f32; 512], z: usize) -> &[f32; LAYER] {
    // A slice of 64 values is an array of 64 values.
    values[z * LAYER..].first_chunk().unwrap_or(&[0.0; LAYER])
}

/// c(p) of a layer's voxels. Neighbours in free space have the same log-odds, mostly.
pub fn confidences(log_odds: &[f32; LAYER]) -> [u32; LAYER] {
    let first = log_odds[0];
    let c = confidence(first);
    if log_odds
        .iter()
        .fold(true, |same, l| same & (l.to_bits() == first.to_bits()))
    {
        return [c; LAYER];
    }
    let mut last = (first, c);
    log_odds.map(|l| {
        if l.to_bits() != last.0.to_bits() {
            last = (l, confidence(l));
        }
        last.1
    })
}

/// The voxels of a layer, given the centre of its first, that lie in the frustum.
fn within(frustum: &Frustum, corner: Vec3, resolution: f32) -> u64 {
    mask(|i| {
        let offset = Vec3::new((i & 7) as f32, (i >> 3) as f32, 0.0) * resolution;
        frustum.contains(corner + offset)
    })
}

#[cfg(test)]
mod tests;
