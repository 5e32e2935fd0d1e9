//! Sixteen rays of a view in lockstep (AVX-512), with the arithmetic of the walk one by one, operation for operation.
//!
//! The state of a voxel decides whether its ray goes on; what a metric makes of the voxels comes after. Machines
//! without AVX-512 walk the rays one by one.
use super::window::{Window, WALL};
use crate::belief::lockstep::Lanes;
use crate::geometry::{IVec3, Vec3};

/// Rays walked together.
pub const RAYS: usize = 16;

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

/// Append the voxels with a state in `counted` that the rays meet before and at their first voxel with a state in `opaque`;
/// a voxel once for every ray that meets it. `false`: not on this machine, nothing done.
pub fn list(
    lanes: Lanes,
    frame: &Frame,
    directions: &Directions,
    counted: u8,
    opaque: u8,
    out: &mut Vec<u32>,
) -> bool {
    #[cfg(target_arch = "x86_64")]
    if lanes == Lanes::Avx512 && frame.is_sound() {
        for first in (0..directions.len()).step_by(RAYS) {
            out.reserve(RAYS * (frame.max_steps() + 1));
            let masks = [counted, opaque | WALL];
            // SAFETY: `Lanes` was detected; `frame` is sound; `out` has room for every step of every ray, and one more row.
            unsafe {
                let end = out.as_mut_ptr().add(out.len());
                let added =
                    avx512::walk::<true>(frame, directions, first, masks, end, &mut [0; RAYS]);
                out.set_len(out.len() + added);
            }
        }
        return true;
    }
    let _ = (lanes, frame.max_steps(), directions, counted, opaque, out);
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
    if lanes == Lanes::Avx512 && frame.is_sound() {
        out.voxels.resize(RAYS * (frame.max_steps() + 1), 0);
        // SAFETY: as above.
        unsafe {
            let masks = [0, opaque | WALL];
            avx512::walk::<false>(
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

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::{Directions, Frame, RAYS};
    use std::arch::x86_64::*;

    const GROUPS: usize = RAYS / 8;

    /// With `LIST` the counted voxels go to `out` one after the other, and their number is returned; else all voxels go to
    /// `out` by rows of `RAYS`, and `counts` are the rays' numbers of steps.
    ///
    /// SAFETY: needs AVX-512 F, DQ and VL; a sound frame; room for `RAYS * (max_steps + 1)` numbers at `out`. Reads stay in
    /// the window: rays start inside, move by one voxel and end in its border of walls (part of the opaque states).
    #[target_feature(enable = "avx512f,avx512dq,avx512vl,popcnt")]
    pub unsafe fn walk<const LIST: bool>(
        frame: &Frame,
        directions: &Directions,
        first: usize,
        [counted, opaque]: [u8; 2],
        out: *mut u32,
        counts: &mut [u32; RAYS],
    ) -> usize {
        let window = frame.window;
        let state = window.state.as_ptr();
        let strides = window.strides();
        let zero = _mm512_setzero_pd();
        let far = _mm512_set1_pd(f64::MAX);
        let range = _mm512_set1_pd(frame.max_range);
        let counted = _mm256_set1_epi32(i32::from(counted));
        let opaque = _mm256_set1_epi32(i32::from(opaque));
        let mut t = [[far; 3]; GROUPS];
        let mut dt = [[far; 3]; GROUPS];
        let mut step = [[_mm256_setzero_si256(); 3]; GROUPS];
        let mut cell = [_mm256_set1_epi32(window.index(frame.start) as i32); GROUPS];
        let mut active = [0u8; GROUPS];
        let mut made = [_mm256_setzero_si256(); GROUPS];
        for g in 0..GROUPS {
            let i = first + g * 8;
            if i >= directions.len() {
                break;
            }
            let lanes = (directions.len() - i).min(8);
            let mask = ((1u32 << lanes) - 1) as u8;
            active[g] = mask;
            for axis in 0..3 {
                // As in `Dda::new`.
                let center = (f64::from(frame.start[axis]) + 0.5) * frame.resolution;
                let half = f64::from((frame.resolution * 0.5) as f32);
                let origin = f64::from(frame.origin[axis]);
                // SAFETY: the masked load touches only the `lanes` elements that exist.
                let d =
                    unsafe { _mm256_maskz_loadu_ps(mask, directions.axes[axis].as_ptr().add(i)) };
                let d = _mm512_cvtps_pd(d);
                let plus = _mm512_cmp_pd_mask::<_CMP_GT_OQ>(d, zero);
                let minus = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(d, zero);
                let border = _mm512_mask_blend_pd(
                    plus,
                    _mm512_set1_pd(center - half - origin),
                    _mm512_set1_pd(center + half - origin),
                );
                t[g][axis] = _mm512_mask_div_pd(far, plus | minus, border, d);
                dt[g][axis] = _mm512_mask_div_pd(
                    far,
                    plus | minus,
                    _mm512_set1_pd(frame.resolution),
                    _mm512_abs_pd(d),
                );
                let stride = strides[axis] as i32;
                step[g][axis] = _mm256_mask_blend_epi32(
                    plus,
                    _mm256_set1_epi32(-stride),
                    _mm256_set1_epi32(stride),
                );
            }
        }
        let mut listed = 0;
        let mut row = 0;
        while active.iter().any(|a| *a != 0) {
            for g in 0..GROUPS {
                // SAFETY: see above; inactive lanes are not read, and each row has its room at `out`.
                let states = unsafe {
                    _mm256_mmask_i32gather_epi32::<1>(
                        _mm256_setzero_si256(),
                        active[g],
                        cell[g],
                        state.cast(),
                    )
                };
                if LIST {
                    let hits = _mm256_mask_test_epi32_mask(active[g], states, counted);
                    unsafe {
                        _mm256_storeu_si256(
                            out.add(listed).cast(),
                            _mm256_maskz_compress_epi32(hits, cell[g]),
                        )
                    };
                    listed += hits.count_ones() as usize;
                } else {
                    unsafe { _mm256_storeu_si256(out.add(row + g * 8).cast(), cell[g]) };
                    made[g] =
                        _mm256_mask_add_epi32(made[g], active[g], made[g], _mm256_set1_epi32(1));
                }
                active[g] &= _mm256_testn_epi32_mask(states, opaque);
                let [t0, t1, t2] = t[g];
                let below01 = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(t0, t1);
                let below02 = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(t0, t2);
                let below12 = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(t1, t2);
                let x = below01 & below02;
                let y = !below01 & below12;
                let z = !(x | y);
                let entry = _mm512_min_pd(_mm512_min_pd(t0, t1), t2);
                t[g][0] = _mm512_mask_add_pd(t0, x, t0, dt[g][0]);
                t[g][1] = _mm512_mask_add_pd(t1, y, t1, dt[g][1]);
                t[g][2] = _mm512_mask_add_pd(t2, z, t2, dt[g][2]);
                cell[g] = _mm256_mask_add_epi32(cell[g], x, cell[g], step[g][0]);
                cell[g] = _mm256_mask_add_epi32(cell[g], y, cell[g], step[g][1]);
                cell[g] = _mm256_mask_add_epi32(cell[g], z, cell[g], step[g][2]);
                active[g] &= _mm512_cmp_pd_mask::<_CMP_LE_OQ>(entry, range);
            }
            row += RAYS;
        }
        for (g, made) in made.into_iter().enumerate() {
            // SAFETY: eight counts a group.
            unsafe { _mm256_storeu_si256(counts.as_mut_ptr().add(g * 8).cast(), made) };
        }
        listed
    }
}
