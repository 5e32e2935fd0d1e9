//! What is not known yet: counts of unknown voxels and sums of Shannon entropy, in bits.
use super::rays::VoxelGain;
use super::window::{Window, FREE, OCCUPIED, UNIT, UNKNOWN};
use super::RayGain;

/// Number of distinct unknown voxels within sight; rays pass through unknown space and end at occupied voxels
/// (Bircher 2016, without the factor of a voxel's volume).
pub struct UnknownCount;

impl VoxelGain for UnknownCount {
    const COUNTED: u8 = UNKNOWN;
    const OPAQUE: u8 = OCCUPIED;

    fn of(&self, _: &Window, _: usize) -> u64 {
        UNIT as u64
    }
}

/// Sum of H(p) over the distinct voxels within sight, the occupied ones that end rays among them; 1 bit where unknown.
pub struct Entropy;

impl VoxelGain for Entropy {
    const COUNTED: u8 = UNKNOWN | FREE | OCCUPIED;
    const OPAQUE: u8 = OCCUPIED;

    fn of(&self, window: &Window, voxel: usize) -> u64 {
        u64::from(window.entropy[voxel])
    }
}

/// Mean of H(p) over all voxels on the rays that end at an occupied voxel (Kriegel 2015, as in Delmerico 2018);
/// a voxel counts once a ray. 0 if no ray hits.
#[derive(Default)]
pub struct AverageEntropy {
    ray: (u64, u64),
    all: (u64, u64),
}

impl RayGain for AverageEntropy {
    fn begin_ray(&mut self) {
        self.ray = (0, 0);
    }

    fn visit(&mut self, window: &Window, voxel: usize, _: u8) {
        self.ray.0 += u64::from(window.entropy[voxel]);
        self.ray.1 += 1;
    }

    fn end_ray(&mut self, hit: bool) {
        if hit {
            self.all.0 += self.ray.0;
            self.all.1 += self.ray.1;
        }
    }

    fn value(&self) -> f64 {
        match self.all {
            (_, 0) => 0.0,
            (sum, count) => sum as f64 / UNIT / count as f64,
        }
    }
}
