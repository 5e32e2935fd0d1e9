//! Thirty-two rays of a view in lockstep (AVX-512 or AVX2), with the arithmetic of the walk one by one, operation for operation.
//!
//! The state of a voxel decides whether its ray goes on; what a metric makes of the voxels comes after. Machines
//! without these instructions walk the rays one by one.
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;

use super::window::{Window, WALL};
use crate::belief::lockstep::Lanes;
use crate::geometry::{IVec3, Vec3};
use std::ops::Range;

/// Rays walked together: so many that some go on while others wait for memory.
pub const RAYS: usize = 32;

/// What all rays of a view share.
pub struct Frame<'a> {
    pub window: &'a Window,
    pub resolution: f64,
    pub origin: Vec3,
    pub start: IVec3,
    pub max_range: f64,
}

impl Frame<'_> {
    /// More steps no ray can make: each leads on along one axis.
    fn max_steps(&self) -> usize {
        let d = self.window.dims;
        (d.x + d.y + d.z) as usize
    }

    #[cfg(target_arch = "x86_64")]
    fn is_sound(&self) -> bool {
        let d = self.window.dims;
        let voxels = d.x as usize * d.y as usize * d.z as usize;
        self.window.state.len() == voxels + 3
            && voxels < i32::MAX as usize
            && self.window.region().contains(self.start)
    }
}

/// Unit directions in the world, by axis.
#[derive(Default)]
pub struct Directions {
    pub axes: [Vec<f32>; 3],
}

impl Directions {
    pub fn len(&self) -> usize {
        self.axes[0].len()
    }

    pub fn get(&self, ray: usize) -> Vec3 {
        Vec3::new(self.axes[0][ray], self.axes[1][ray], self.axes[2][ray])
    }
}

/// The voxels of up to `RAYS` rays in the order of the walk: step s of ray r is number `s * RAYS + r`.
#[derive(Default)]
pub struct Steps {
    pub voxels: Vec<u32>,
    pub counts: [u32; RAYS],
}

/// With `LIST` the voxels with a state in the first mask go to the pointer one after the other, and their number is returned;
/// else all voxels go there by rows of `RAYS`, and the counts are the rays' numbers of steps. Rays end at states in the
/// second mask, which must hold `WALL`.
///
/// SAFETY: needs the instructions; a sound frame; room for `RAYS * (max_steps + 1)` numbers. Reads stay in the window: rays
/// start inside, move by one voxel and end in its border of walls.
#[cfg(target_arch = "x86_64")]
type Walk = unsafe fn(&Frame, &Directions, usize, [u8; 2], *mut u32, &mut [u32; RAYS]) -> usize;

#[cfg(target_arch = "x86_64")]
fn walk_of<const LIST: bool>(lanes: Lanes) -> Walk {
    match lanes {
        Lanes::Avx512 => avx512::walk::<LIST>,
        _ => avx2::walk::<LIST>,
    }
}

/// Append the voxels with a state in `counted` that some rays meet before and at their first voxel with a state in `opaque`;
/// a voxel as often as rays meet it, or less often. The range begins at a multiple of `RAYS` and ends at one or at the last ray.
/// `false`: not on this machine, nothing done.
pub fn list(
    lanes: Lanes,
    frame: &Frame,
    directions: &Directions,
    rays: Range<usize>,
    [counted, opaque]: [u8; 2],
    out: &mut Vec<u32>,
) -> bool {
    #[cfg(target_arch = "x86_64")]
    if lanes != Lanes::Scalar && frame.is_sound() {
        let walk = walk_of::<true>(lanes);
        for first in rays.step_by(RAYS) {
            out.reserve(RAYS * (frame.max_steps() + 1));
            let masks = [counted, opaque | WALL];
            // SAFETY: `Lanes` was detected; `frame` is sound; `out` has room for every step of every ray, and one more row.
            unsafe {
                let end = out.as_mut_ptr().add(out.len());
                let added = walk(frame, directions, first, masks, end, &mut [0; RAYS]);
                out.set_len(out.len() + added);
            }
        }
        return true;
    }
    let _ = (
        lanes,
        frame.max_steps(),
        directions,
        rays,
        counted,
        opaque,
        out,
    );
    false
}

/// Walk rays `first .. first + RAYS` up to and with their first voxel with a state in `opaque`. `false`: not on this machine.
pub fn steps(
    lanes: Lanes,
    frame: &Frame,
    directions: &Directions,
    first: usize,
    opaque: u8,
    out: &mut Steps,
) -> bool {
    #[cfg(target_arch = "x86_64")]
    if lanes != Lanes::Scalar && frame.is_sound() {
        out.voxels.resize(RAYS * (frame.max_steps() + 1), 0);
        // SAFETY: as above.
        unsafe {
            let masks = [0, opaque | WALL];
            walk_of::<false>(lanes)(
                frame,
                directions,
                first,
                masks,
                out.voxels.as_mut_ptr(),
                &mut out.counts,
            );
        }
        return true;
    }
    let _ = (lanes, frame, directions, first, opaque, out);
    false
}
