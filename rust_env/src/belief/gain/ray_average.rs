//! Gains that average utilities along rays (Wang et al. 2019, section III-B).
//!
//! A ray's utility is the mean utility of its visible voxels: those from the sensor's minimum range up to, and with, the
//! first occupied one, or up to the maximum range. A view's gain is the mean over its rays, in [0, 1]. What differs is the
//! utility of a voxel:
//!
//! - `view_history` (InfoGain), Eq. 3: 1 if it was never seen, else `1 / sum C_k` if it was never seen from the candidate's
//!   direction and `c(O_k[i]) / sum C_k` if it was; at most 1 (the sum is small for voxels seen at p = 1/2). A ray that meets
//!   an unexplored voxel has utility 1.
//! - `ray_entropy` (BaseGain-E): H(p), without a memory of directions. Unexplored voxels count nothing: "the standard octomap
//!   structure" has no node for them, and with the rule above BaseGain explores and does not "saturate due to being stuck
//!   at a local area", as the paper reports (docs/wang2019.md).
//! - `ray_probability` (BaseGain-P): `1 - |2 p - 1|`, how near p is to 1/2. The paper gives no formula and refers to Meng et al.
//!   2017; this is our reading.
use super::Task;
use crate::belief::lockstep::Lanes;
use crate::belief::octree::{KeyBox, SIDE};
use crate::belief::view_history::sectors::Sectors;
use crate::error::Result;
use crate::geometry::{IVec3, Mat3, Pose, Vec3};
use field::Field;
use std::cell::RefCell;
use utilities::Utilities;
use walk::{Rays, Walk};

mod field;
mod utilities;
mod walk;

pub use utilities::Utility;

/// Memory kept from view to view.
#[derive(Default)]
pub struct Scratch {
    field: Field,
    rays: Rays,
}

impl Scratch {
    /// Work with the memory of this thread: a field is large, and to clear it costs more than a short view.
    pub fn of_this_thread<T>(work: impl FnOnce(&mut Self) -> T) -> T {
        thread_local! {
            static SCRATCH: RefCell<Scratch> = RefCell::default();
        }
        SCRATCH.with_borrow_mut(|scratch| {
            let done = work(scratch);
            scratch.field.give_back();
            done
        })
    }
}

impl Task<'_> {
    /// The gain of one view. `region` holds all voxels that its rays can meet.
    pub(super) fn ray_average(
        &self,
        lanes: Lanes,
        utility: Utility,
        view: &Pose,
        region: KeyBox,
        scratch: &mut Scratch,
    ) -> Result<f64> {
        let octree = self.octree;
        let Some(start) = octree.key(view.translation).filter(|k| region.contains(*k)) else {
            return Ok(0.0);
        };
        let Scratch { field, rays } = scratch;
        field.lay(region)?;
        let resolution = octree.resolution() as f32;
        let utilities = Utilities {
            utility,
            history: octree.view_history(),
            sectors: Sectors::new(view.translation),
            resolution,
            radius: resolution * SIDE as f32 * 0.5 * 3f32.sqrt(),
            region,
            bounds: self.bounds,
        };
        let walk = Walk {
            strides: field.strides(),
            start: field.number(start) as i32,
            steps: (region.max - region.min + 2).element_sum() as usize,
            key: start,
            origin: view.translation,
            resolution: octree.resolution(),
            near: f64::from(self.near),
            max_range: f64::from(self.max_range),
        };
        rays.turn(&Mat3::from_quat(view.rotation), &self.directions);
        let fill = |field: &mut Field, number| self.fill(lanes, field, number, &utilities);
        walk.mean(lanes, rays, &self.places, field, fill, &self.stop)
    }

    /// Compute the utilities of the voxels of the brick that holds a voxel of this number.
    fn fill(&self, lanes: Lanes, field: &mut Field, number: usize, utilities: &Utilities) {
        let octree = self.octree;
        let corner = field.brick(number);
        let key = corner * SIDE;
        let brick = octree
            .root()
            .index(corner)
            .and_then(|c| octree.root().brick(c))
            .map(|n| (n, &octree.bricks()[n]));
        let (first, out) = (octree.center(key), field.fill(number));
        match lanes {
            Lanes::Scalar => utilities.brick(key, first, brick, out),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `lanes` says that the machine has these instructions.
            Lanes::Avx2 => unsafe { compiled::brick_avx2(utilities, key, first, brick, out) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            Lanes::Avx512 => unsafe { compiled::brick_avx512(utilities, key, first, brick, out) },
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod compiled {
    use super::{IVec3, Utilities, Vec3};
    use crate::belief::octree::Brick;

    type Numbered<'a> = Option<(usize, &'a Brick)>;

    #[target_feature(enable = "avx2")]
    pub fn brick_avx2(u: &Utilities, key: IVec3, first: Vec3, brick: Numbered, out: &mut [u32]) {
        u.brick(key, first, brick, out);
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,popcnt")]
    pub fn brick_avx512(u: &Utilities, key: IVec3, first: Vec3, brick: Numbered, out: &mut [u32]) {
        u.brick(key, first, brick, out);
    }
}

#[cfg(test)]
mod tests;
