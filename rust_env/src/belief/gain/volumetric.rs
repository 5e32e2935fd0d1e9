//! The volumetric metrics of Isler et al. (ICRA 2016) and Delmerico et al. (Autonomous Robots 2018), after the papers.
//!
//! A ray passes free and unknown voxels and ends with the first occupied one or at the maximum range. Visibility of
//! its n-th voxel: the product of (1 - p) over the voxels before it (a public implementation multiplies p instead).
//! p = 0.5 where unknown. Entropies H are in *bits* here (the papers use the natural logarithm: a constant factor).
//! A ray that meets nothing adds what lies within the maximum range and no more. Sums run over rays: a voxel that
//! several rays cross counts several times.
use super::window::{Window, FREE, OCCUPIED, REACH, UNIT, UNKNOWN};
use super::RayGain;

#[inline]
fn entropy(window: &Window, voxel: usize) -> f32 {
    window.entropy[voxel] as f32 * (1.0 / UNIT as f32)
}

/// Visibility times entropy.
#[derive(Default)]
pub struct OcclusionAware {
    visibility: f32,
    ray: f32,
    sum: f64,
}

impl RayGain for OcclusionAware {
    fn begin_ray(&mut self) {
        (self.visibility, self.ray) = (1.0, 0.0);
    }
    fn visit(&mut self, window: &Window, voxel: usize, _: u8) {
        self.ray += self.visibility * entropy(window, voxel);
        self.visibility *= 1.0 - window.probability[voxel];
    }
    fn end_ray(&mut self, _: bool) {
        self.sum += f64::from(self.ray);
    }
    fn value(&self) -> f64 {
        self.sum
    }
}

/// Visibility times entropy of the voxels that were never observed.
#[derive(Default)]
pub struct UnobservedVoxel {
    visibility: f32,
    ray: f32,
    sum: f64,
}

impl RayGain for UnobservedVoxel {
    fn begin_ray(&mut self) {
        (self.visibility, self.ray) = (1.0, 0.0);
    }
    fn visit(&mut self, window: &Window, voxel: usize, state: u8) {
        if state == UNKNOWN {
            self.ray += self.visibility * entropy(window, voxel);
        }
        self.visibility *= 1.0 - window.probability[voxel];
    }
    fn end_ray(&mut self, _: bool) {
        self.sum += f64::from(self.ray);
    }
    fn value(&self) -> f64 {
        self.sum
    }
}

/// Number of rays that reach an occupied voxel directly out of unknown space: its rear side.
#[derive(Default)]
pub struct RearSideVoxel {
    before: u8,
    count: u64,
}

impl RayGain for RearSideVoxel {
    fn begin_ray(&mut self) {
        self.before = 0;
    }
    fn visit(&mut self, _: &Window, _: usize, state: u8) {
        if state == OCCUPIED && self.before == UNKNOWN {
            self.count += 1;
        }
        self.before = state;
    }
    fn end_ray(&mut self, _: bool) {}
    fn value(&self) -> f64 {
        self.count as f64
    }
}

/// Visibility times entropy over the run of unknown voxels right before an occupied one.
#[derive(Default)]
pub struct RearSideEntropy {
    visibility: f32,
    run: f32,
    sum: f64,
}

impl RayGain for RearSideEntropy {
    fn begin_ray(&mut self) {
        (self.visibility, self.run) = (1.0, 0.0);
    }
    fn visit(&mut self, window: &Window, voxel: usize, state: u8) {
        match state {
            UNKNOWN => self.run += self.visibility * entropy(window, voxel),
            FREE => self.run = 0.0,
            _ => {}
        }
        self.visibility *= 1.0 - window.probability[voxel];
    }
    fn end_ray(&mut self, hit: bool) {
        if hit {
            self.sum += f64::from(self.run);
        }
    }
    fn value(&self) -> f64 {
        self.sum
    }
}

/// Sum over the unknown voxels of `REACH + 1` minus the distance (in voxels) to the nearest occupied voxel, nothing
/// beyond `REACH`. The papers take the distance behind the surface as measured; here it is the Euclidean distance:
/// what lies in front of a measured surface has been seen, so an unknown voxel close to it lies behind or beside it.
#[derive(Default)]
pub struct ProximityCount {
    ray: f32,
    sum: f64,
}

impl RayGain for ProximityCount {
    fn begin_ray(&mut self) {
        self.ray = 0.0;
    }
    fn visit(&mut self, window: &Window, voxel: usize, state: u8) {
        let squared = i32::from(window.distance[voxel]);
        if state == UNKNOWN && squared <= REACH * REACH {
            self.ray += (REACH + 1) as f32 - (squared as f32).sqrt();
        }
    }
    fn end_ray(&mut self, _: bool) {
        self.sum += f64::from(self.ray);
    }
    fn value(&self) -> f64 {
        self.sum
    }
}

/// Desired shares of rays that end at surface and at the border of occluded space (Vasquez-Gomez et al. 2014).
pub const AREA_FACTOR_OCCUPIED: f64 = 0.2;
pub const AREA_FACTOR_OCCLUDED: f64 = 0.8;

/// Each ray counts by its first voxel that is not free: occupied; occluded (unknown, entered from free space: an
/// "occplane"); unmarked (unknown from the camera on, or none). f(share of occupied, 0.2) + f(share of occluded, 0.8),
/// where f rises as a cubic from 0 at 0 to 1 at the desired share and falls to 0 at 1 (Vasquez-Gomez et al. 2014).
#[derive(Default)]
pub struct AreaFactor {
    done: bool,
    before: u8,
    rays: u64,
    occupied: u64,
    occluded: u64,
}

impl RayGain for AreaFactor {
    fn begin_ray(&mut self) {
        (self.done, self.before) = (false, 0);
        self.rays += 1;
    }
    fn visit(&mut self, _: &Window, _: usize, state: u8) {
        if !self.done {
            self.done = state != FREE;
            self.occupied += u64::from(state == OCCUPIED);
            self.occluded += u64::from(state == UNKNOWN && self.before == FREE);
            self.before = state;
        }
    }
    fn end_ray(&mut self, _: bool) {}
    fn value(&self) -> f64 {
        let share = |n: u64| n as f64 / self.rays.max(1) as f64;
        preference(share(self.occupied), AREA_FACTOR_OCCUPIED)
            + preference(share(self.occluded), AREA_FACTOR_OCCLUDED)
    }
}

/// Two cubics that meet at `best` with value 1 and slope 0, and are 0 at 0 and at 1.
fn preference(x: f64, best: f64) -> f64 {
    if x <= best {
        let r = x / best;
        r * r * (3.0 - 2.0 * r)
    } else {
        let r = (1.0 - x) / (1.0 - best);
        r * r * (3.0 - 2.0 * r)
    }
}
