//! Where the rays of an image end: OctoMap's `computeUpdate`, many points at a time, in its arithmetic (f32 vectors,
//! f64 norms and keys).
//!
//! One source, compiled for each kind of [`Lanes`]: loops over blocks of equal length that compilers vectorise. Rust
//! never fuses or reorders operations on floats, so that every kind gives the same bits.
use super::optics::Optics;
use crate::belief::lockstep::Lanes;
use crate::belief::octree::{Octree, KEY_LIMIT};
use crate::belief::uncertainty::{self, UncertaintyModel};
use crate::camera::{Camera, DepthKind};
use crate::geometry::{IVec3, Pose, Vec3};

/// Points that are worked on together; every list is padded to a multiple of it.
pub const BLOCK: usize = 64;
type Block = [f32; BLOCK];

/// The rays of an image, by axis. Rays without an end (no measurement, or beyond the key space) end at the sensor and
/// hit nothing, and so does the padding.
#[derive(Clone, Default)]
pub struct Ends {
    /// First the measured points (world frame, metres; NaN: none), then where the rays end.
    pub position: [Vec<f32>; 3],
    pub key: [Vec<i32>; 3],
    pub hit: Vec<bool>,
    /// Uncertainty of the measurement, if it is a hit.
    pub uncertainty: Vec<f32>,
    /// Box of all keys and the sensor's, both corners included.
    pub low: IVec3,
    pub high: IVec3,
}

/// What all rays of an image share.
#[derive(Clone, Copy)]
pub struct Sensor {
    pub origin: Vec3,
    pub start: IVec3,
    /// Metres; infinite: unlimited.
    pub max_range: f64,
    /// Voxels a metre.
    pub inverse: f64,
}

/// A depth image and the way from its pixels to points.
struct Image<'a> {
    depth: &'a [f32],
    optics: &'a Optics,
    world_from_camera: &'a Pose,
    kind: DepthKind,
    /// Range of rays that met nothing, beyond the maximum.
    beyond: f32,
    focal_distance: f32,
}

impl Ends {
    pub fn len(&self) -> usize {
        self.hit.len()
    }

    /// The voxel in which ray `i` ends.
    #[inline]
    pub fn last(&self, i: usize) -> IVec3 {
        IVec3::new(self.key[0][i], self.key[1][i], self.key[2][i])
    }

    fn resize(&mut self, points: usize) {
        let padded = points.next_multiple_of(BLOCK);
        for axis in 0..3 {
            self.position[axis].resize(padded, 0.0);
            self.key[axis].resize(padded, 0);
        }
        self.hit.resize(padded, false);
        self.uncertainty.resize(padded, 1.0);
    }

    /// The rays of a depth image (row-major), in the order of `optics`. NaN, negative and zero depths are no measurement, +inf a ray that met nothing.
    pub fn of_depth(
        &mut self,
        lanes: Lanes,
        depth: &[f32],
        camera: &Camera,
        optics: &Optics,
        world_from_camera: &Pose,
        sensor: &Sensor,
    ) {
        self.resize(depth.len());
        let image = Image {
            depth,
            optics,
            world_from_camera,
            kind: camera.kind,
            beyond: (2.0 * sensor.max_range) as f32,
            focal_distance: optics.model.focal_distance,
        };
        match lanes {
            Lanes::Scalar => image.unproject(self),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Lanes` is only made where the features were detected.
            Lanes::Avx2 => unsafe { compiled::unproject_avx2(&image, self) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            Lanes::Avx512 => unsafe { compiled::unproject_avx512(&image, self) },
        }
    }

    /// The points of a cloud (world frame), without a camera: the uncertainty is that of the distance alone (Lluvia 2023, Eq. 2).
    pub fn of_points(&mut self, points: impl IntoIterator<Item = Vec3>, origin: Vec3) {
        self.resize(0);
        for p in points {
            for axis in 0..3 {
                self.position[axis].push(p[axis]);
            }
            self.uncertainty.push(uncertainty::of_distance(
                (p - origin).length(),
                UncertaintyModel::FOCAL_DISTANCE,
            ));
        }
        let points = self.uncertainty.len();
        self.resize(points);
        for axis in &mut self.position {
            axis[points..].fill(f32::NAN);
        }
    }

    /// Keep of the points in each voxel only the first, moved to the voxel's centre, with the least uncertainty of all:
    /// OctoMap's `discretize`.
    pub fn discretize(&mut self, octree: &Octree, seen: &mut Seen) {
        seen.clear(self.len());
        let mut kept = 0;
        for i in 0..self.uncertainty.len() {
            let point = Vec3::from(std::array::from_fn::<f32, 3, _>(|a| self.position[a][i]));
            let Some(key) = octree.key(point) else {
                continue;
            };
            let uncertainty = self.uncertainty[i];
            match seen.number(key, kept as u32) {
                Some(before) => {
                    let u = &mut self.uncertainty[before as usize];
                    *u = u.min(uncertainty);
                }
                None => {
                    let center = octree.center(key);
                    for axis in 0..3 {
                        self.position[axis][kept] = center[axis];
                    }
                    self.uncertainty[kept] = uncertainty;
                    kept += 1;
                }
            }
        }
        self.resize(kept);
        for axis in &mut self.position {
            axis[kept..].fill(f32::NAN);
        }
    }

    /// From the points to where their rays end: in the point's voxel if it is within range, else at the maximum range.
    pub fn find(&mut self, lanes: Lanes, sensor: &Sensor) {
        match lanes {
            Lanes::Scalar => self.find_blocks(sensor),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Lanes` is only made where the features were detected.
            Lanes::Avx2 => unsafe { compiled::find_avx2(self, sensor) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            Lanes::Avx512 => unsafe { compiled::find_avx512(self, sensor) },
        }
    }

    #[inline(always)]
    fn find_blocks(&mut self, sensor: &Sensor) {
        let (mut low, mut high) = ([[0; BLOCK]; 3], [[0; BLOCK]; 3]);
        for axis in 0..3 {
            low[axis] = [sensor.start[axis]; BLOCK];
            high[axis] = low[axis];
        }
        for first in (0..self.len()).step_by(BLOCK) {
            let mut position = [[0.0; BLOCK]; 3];
            for (axis, p) in position.iter_mut().enumerate() {
                p.copy_from_slice(&self.position[axis][first..first + BLOCK]);
            }
            let (key, hit) = sensor.end(&mut position);
            for axis in 0..3 {
                for i in 0..BLOCK {
                    low[axis][i] = low[axis][i].min(key[axis][i]);
                    high[axis][i] = high[axis][i].max(key[axis][i]);
                }
                self.position[axis][first..first + BLOCK].copy_from_slice(&position[axis]);
                self.key[axis][first..first + BLOCK].copy_from_slice(&key[axis]);
            }
            self.hit[first..first + BLOCK].copy_from_slice(&hit);
        }
        self.low = IVec3::from(low.map(|axis| axis.into_iter().fold(i32::MAX, i32::min)));
        self.high = IVec3::from(high.map(|axis| axis.into_iter().fold(i32::MIN, i32::max)));
    }
}

impl Sensor {
    /// Move points to where their rays end; returns the keys and which are hits.
    #[inline(always)]
    fn end(&self, points: &mut [Block; 3]) -> ([[i32; BLOCK]; 3], [bool; BLOCK]) {
        let (ox, oy, oz) = (self.origin.x, self.origin.y, self.origin.z);
        let reach = self.max_range as f32;
        let mut hit = [false; BLOCK];
        let mut length = [0.0f32; BLOCK];
        let [px, py, pz] = &mut *points;
        for i in 0..BLOCK {
            let (dx, dy, dz) = (px[i] - ox, py[i] - oy, pz[i] - oz);
            // OctoMap's `norm`: the sum of squares in f32, the root in f64.
            let norm = f64::from(dx * dx + dy * dy + dz * dz).sqrt();
            hit[i] = norm <= self.max_range;
            length[i] = norm as f32;
        }
        for (p, o) in [(&mut *px, ox), (&mut *py, oy), (&mut *pz, oz)] {
            for i in 0..BLOCK {
                let limited = o + (p[i] - o) / length[i] * reach;
                p[i] = if hit[i] { p[i] } else { limited };
            }
        }
        let mut valid = [true; BLOCK];
        let mut key = [[0; BLOCK]; 3];
        for (p, key) in [&*px, &*py, &*pz].into_iter().zip(&mut key) {
            for i in 0..BLOCK {
                key[i] = self.key_of(p[i]);
                valid[i] &= (key[i] >= -KEY_LIMIT) & (key[i] < KEY_LIMIT);
            }
        }
        for (axis, (key, point)) in key.iter_mut().zip(points).enumerate() {
            let (start, origin) = (self.start[axis], self.origin[axis]);
            for i in 0..BLOCK {
                key[i] = if valid[i] { key[i] } else { start };
                point[i] = if valid[i] { point[i] } else { origin };
            }
        }
        for i in 0..BLOCK {
            hit[i] &= valid[i];
        }
        (key, hit)
    }

    /// As [`Octree::key_of`], but anything outside the key space, and NaN, becomes some key outside of it.
    #[inline(always)]
    fn key_of(&self, coordinate: f32) -> i32 {
        const FAR: f64 = 2.0 * KEY_LIMIT as f64;
        let x = self.inverse * f64::from(coordinate);
        // False for NaN.
        let x = if x > -FAR { x } else { -FAR };
        let x = if x < FAR { x } else { FAR };
        // SAFETY: within +-65536.
        let t: i32 = unsafe { x.to_int_unchecked() };
        t - i32::from(x < f64::from(t))
    }
}

impl Image<'_> {
    #[inline(always)]
    fn unproject(&self, ends: &mut Ends) {
        let optics = self.optics;
        for first in (0..ends.len()).step_by(BLOCK) {
            let block = |list: &[f32]| -> Block {
                let mut block = [0.0; BLOCK];
                block.copy_from_slice(&list[first..first + BLOCK]);
                block
            };
            let mut depth = [f32::NAN; BLOCK];
            let order = &optics.witnesses.order;
            for (depth, pixel) in depth.iter_mut().zip(&order[first.min(order.len())..]) {
                *depth = self.depth[*pixel as usize];
            }
            let (points, distance) = self.points(
                &depth,
                &block(&optics.x),
                &block(&optics.y),
                &block(&optics.length),
            );
            let angle = block(&optics.angle);
            let mut uncertain = [0.0; BLOCK];
            for i in 0..BLOCK {
                let of_distance = uncertainty::of_distance(distance[i], self.focal_distance);
                uncertain[i] = (of_distance + angle[i]) * 0.5;
            }
            for (position, points) in ends.position.iter_mut().zip(&points) {
                position[first..first + BLOCK].copy_from_slice(points);
            }
            ends.uncertainty[first..first + BLOCK].copy_from_slice(&uncertain);
        }
    }

    /// The world points of pixels and their ranges, with the operations of [`Camera::unproject`] in their order
    /// (the rotation is glam's on x86-64); NaN where there is no measurement.
    #[inline(always)]
    fn points(&self, depth: &Block, x: &Block, y: &Block, length: &Block) -> ([Block; 3], Block) {
        let (q, t) = (
            self.world_from_camera.rotation,
            self.world_from_camera.translation,
        );
        let along = q.w * q.w - (q.x * q.x + q.y * q.y + q.z * q.z);
        let twice = q.w * 2.0;
        let is_range = self.kind == DepthKind::Range;
        let mut scale = [0.0f32; BLOCK];
        for i in 0..BLOCK {
            let d = depth[i];
            let nothing = d == f32::INFINITY;
            let ratio = (if nothing { self.beyond } else { d }) / length[i];
            let measured = if nothing | is_range { ratio } else { d };
            scale[i] = if d > 0.0 { measured } else { f32::NAN };
        }
        let mut points = [[0.0; BLOCK]; 3];
        let mut distance = [0.0; BLOCK];
        for i in 0..BLOCK {
            let (vx, vy, vz) = (x[i] * scale[i], y[i] * scale[i], scale[i]);
            let dot = (vx * q.x + vy * q.y + vz * q.z) * 2.0;
            points[0][i] = vx * along + q.x * dot + (q.y * vz - q.z * vy) * twice + t.x;
            points[1][i] = vy * along + q.y * dot + (q.z * vx - q.x * vz) * twice + t.y;
            points[2][i] = vz * along + q.z * dot + (q.x * vy - q.y * vx) * twice + t.z;
            distance[i] = scale[i] * length[i];
        }
        (points, distance)
    }
}

#[cfg(target_arch = "x86_64")]
mod compiled {
    use super::{Ends, Image, Sensor};

    #[target_feature(enable = "avx2")]
    pub fn unproject_avx2(image: &Image, ends: &mut Ends) {
        image.unproject(ends);
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw")]
    pub fn unproject_avx512(image: &Image, ends: &mut Ends) {
        image.unproject(ends);
    }

    #[target_feature(enable = "avx2")]
    pub fn find_avx2(ends: &mut Ends, sensor: &Sensor) {
        ends.find_blocks(sensor);
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw")]
    pub fn find_avx512(ends: &mut Ends, sensor: &Sensor) {
        ends.find_blocks(sensor);
    }
}

/// Which voxels were met before: a table with open addressing.
#[derive(Clone, Default)]
pub struct Seen {
    /// Packed key plus one, and the voxel's number.
    slots: Vec<(u64, u32)>,
}

impl Seen {
    fn clear(&mut self, most: usize) {
        self.slots.clear();
        self.slots.resize((2 * most).next_power_of_two(), (0, 0));
    }

    /// The number of a voxel that was met before; else remembers `number` for it.
    fn number(&mut self, key: IVec3, number: u32) -> Option<u32> {
        let part = |k: i32| u64::from((k + KEY_LIMIT) as u16);
        let packed = (part(key.z) << 32 | part(key.y) << 16 | part(key.x)) + 1;
        let mask = self.slots.len() - 1;
        // Fibonacci hashing: the upper bits of the product are well mixed.
        let mut at = (packed.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32) as usize & mask;
        loop {
            match self.slots[at] {
                (0, _) => {
                    self.slots[at] = (packed, number);
                    return None;
                }
                (found, before) if found == packed => return Some(before),
                _ => at = (at + 1) & mask,
            }
        }
    }
}
