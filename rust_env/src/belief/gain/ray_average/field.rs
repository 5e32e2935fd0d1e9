//! The utilities of the voxels around a view's rays, as seen from the view's position.
//!
//! Rays are stopped by what is occupied or unexplored, mostly long before their range: bricks are filled when a ray first meets
//! them. A brick's voxels stand side by side, so that filling it, emptying it and walking through it stay in half a page.
use crate::belief::octree::{voxel_in_brick, KeyBox, VOXELS};
use crate::error::{Error, Result};
use crate::geometry::IVec3;

/// Utilities are in [0, 1]; the sign says that the voxel is occupied. Other values have a meaning of their own.
pub const UNEXPLORED: f32 = 2.0;
/// Counts nothing, the ray goes on: what lies outside the exploration bounds.
pub const IGNORED: f32 = 3.0;
/// Counts nothing and ends the ray.
pub const WALL: f32 = -4.0;

/// Most voxels of a field, 4 bytes each.
const MAX_VOXELS: u64 = 1 << 27;
/// Most voxels of a field whose memory is kept for the next views.
const MOST_KEPT: usize = 1 << 24;
/// Values are kept as the bits that differ from these: fresh memory, all zeros, says that nothing is computed yet.
const CODE: u32 = 5f32.to_bits();
/// What [`encoded`] makes of no value.
pub const UNFILLED: u32 = 0;

#[inline(always)]
pub fn encoded(value: f32) -> u32 {
    value.to_bits() ^ CODE
}

#[inline(always)]
pub fn decoded(value: u32) -> f32 {
    f32::from_bits(value ^ CODE)
}

/// See the module. A voxel is named by its number in `values`.
#[derive(Default)]
pub struct Field {
    /// The first brick, and how many there are along x, y, z.
    origin: IVec3,
    dims: IVec3,
    /// Brick after brick, x fastest; what [`encoded`] makes of each voxel's value.
    pub values: Vec<u32>,
    /// First voxels of the bricks that are filled.
    filled: Vec<u32>,
}

impl Field {
    /// Lay the field over `region` and the voxels next to it; nothing is filled.
    pub fn lay(&mut self, region: KeyBox) -> Result<()> {
        // What the view before filled is much less than all.
        for first in self.filled.drain(..) {
            self.values[first as usize..first as usize + VOXELS].fill(UNFILLED);
        }
        let voxels = voxels_around(&region);
        if voxels > MAX_VOXELS {
            return Err(Error::invalid(format!(
                "a view's rays span {voxels} voxels, more than {MAX_VOXELS}: use a shorter max_range or a coarser map"
            )));
        }
        (self.origin, self.dims) = bricks_around(&region);
        if self.values.len() < voxels as usize {
            self.values = Vec::new();
            // Regions of other views are a little larger or smaller.
            self.values = vec![UNFILLED; (voxels as usize).next_multiple_of(1 << 20)];
        }
        Ok(())
    }

    /// Keep no more memory than fields commonly need.
    pub fn give_back(&mut self) {
        if self.values.len() > MOST_KEPT {
            *self = Self::default();
        }
    }

    /// Number of a voxel of the field.
    #[inline]
    pub fn number(&self, key: IVec3) -> usize {
        let c: IVec3 = (key >> 3) - self.origin;
        let brick = (c.z as usize * self.dims.y as usize + c.y as usize) * self.dims.x as usize
            + c.x as usize;
        brick * VOXELS + voxel_in_brick(key)
    }

    /// The brick (in bricks) that holds a voxel of this number.
    pub fn brick(&self, number: usize) -> IVec3 {
        let brick = number / VOXELS;
        let (nx, ny) = (self.dims.x as usize, self.dims.y as usize);
        let (x, y, z) = (brick % nx, brick / nx % ny, brick / (nx * ny));
        self.origin + IVec3::new(x as i32, y as i32, z as i32)
    }

    /// A brick's values, to be filled.
    pub fn fill(&mut self, number: usize) -> &mut [u32] {
        let first = number / VOXELS * VOXELS;
        self.filled.push(first as u32);
        &mut self.values[first..first + VOXELS]
    }

    /// Change of a number from one voxel to the next along x, y, z, within a brick and into the next one.
    pub fn strides(&self) -> [[i32; 2]; 3] {
        let bricks = [1, self.dims.x, self.dims.x * self.dims.y];
        std::array::from_fn(|axis| {
            let voxel = 1 << (3 * axis);
            [voxel, bricks[axis] * VOXELS as i32 - 7 * voxel]
        })
    }
}

/// The first brick of a region and of the voxels next to it, and how many there are along x, y, z.
fn bricks_around(region: &KeyBox) -> (IVec3, IVec3) {
    let first = (region.min - 1) >> 3;
    (first, (region.max >> 3) - first + 1)
}

/// Voxels of a field over `region`.
fn voxels_around(region: &KeyBox) -> u64 {
    let bricks = bricks_around(region).1.max(IVec3::ZERO);
    let [x, y, z] = bricks.to_array().map(|n| n as u64);
    x * y * z * VOXELS as u64
}
