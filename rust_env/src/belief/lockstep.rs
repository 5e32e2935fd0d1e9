//! Exact ray tracing of a whole image, eight rays in lockstep (AVX-512) or four (AVX2).
//!
//! The arithmetic is that of [`super::integrate`]'s scalar walk, operation for operation, so that both mark the same
//! voxels; tests compare them. Voxels are marked in a window of bytes around the sensor, x fastest: plain stores of
//! equal values cannot conflict, and a voxel's number changes by a constant per step along an axis.
use crate::geometry::{IVec3, Vec3};
use crate::instructions::{widest, Instructions};

/// A voxel that a ray passed, and one in which a ray ended.
pub const FREE: u8 = 1;
pub const HIT: u8 = 2;
/// Largest window (bytes); larger images take the scalar path.
pub const MAX_WINDOW: u64 = 1 << 26;

/// Rays walked together: lists of rays are padded to a multiple of it.
pub const RAYS: usize = 16;

/// The rays of one image: from the sensor to `end`, whose voxel is number `cell` of the window. All of one length, a
/// multiple of `RAYS`; a ray that ends in the sensor's voxel marks nothing.
pub struct Rays<'a> {
    pub end: [&'a [f32]; 3],
    pub cell: &'a [i32],
}

impl Rays<'_> {
    #[cfg(target_arch = "x86_64")]
    fn is_sound(&self) -> bool {
        let rays = self.cell.len();
        rays.is_multiple_of(RAYS) && self.end.iter().all(|axis| axis.len() == rays)
    }
}

/// What all rays of an image share.
pub struct Frame {
    pub resolution: f64,
    pub origin: Vec3,
    /// The sensor's voxel, and its number in the window.
    pub start: IVec3,
    pub start_cell: i32,
    /// Change of the number per step along x, y, z.
    pub strides: [i32; 3],
}

/// Which instructions this machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lanes {
    Scalar,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Lanes {
    /// The widest kind that this machine can run and that may be used, see [`crate::instructions`].
    pub fn best() -> Self {
        let allowed = |lanes: &Self| match lanes {
            Self::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => widest() >= Instructions::Avx2,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => widest() >= Instructions::Avx512,
        };
        let all = Self::available().into_iter();
        all.rev().find(allowed).unwrap_or(Self::Scalar)
    }

    /// The widest kind that this machine can run.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512bw")
            {
                return Self::Avx512;
            }
            if is_x86_feature_detected!("avx2") {
                return Self::Avx2;
            }
        }
        Self::Scalar
    }

    /// All kinds that this machine can run, for tests.
    pub fn available() -> Vec<Self> {
        let mut all = vec![Self::Scalar];
        #[cfg(target_arch = "x86_64")]
        match Self::detect() {
            Self::Avx512 => all.extend([Self::Avx2, Self::Avx512]),
            Self::Avx2 => all.push(Self::Avx2),
            Self::Scalar => {}
        }
        all
    }
}

/// Mark every voxel from the sensor's up to, not including, the rays' last ones as `FREE`.
/// The window's last byte takes what must not be marked. Returns `false` if there is no such path on this machine.
pub fn trace(lanes: Lanes, frame: &Frame, rays: &Rays, window: &mut [u8]) -> bool {
    match lanes {
        #[cfg(target_arch = "x86_64")]
        _ if window.is_empty() || window.len() > i32::MAX as usize || !rays.is_sound() => false,
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the caller detected the features (`Lanes` is only made by `detect` and `available`); the rays are sound.
        Lanes::Avx2 => unsafe {
            avx2::trace(frame, rays, window);
            true
        },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Lanes::Avx512 => unsafe {
            avx512::trace(frame, rays, window);
            true
        },
        Lanes::Scalar => false,
    }
}

/// Borders of the sensor's voxel as seen from it, per axis: towards minus and towards plus, minus the origin.
#[cfg(target_arch = "x86_64")]
fn borders(frame: &Frame) -> [[f64; 2]; 3] {
    std::array::from_fn(|axis| {
        let center = (f64::from(frame.start[axis]) + 0.5) * frame.resolution;
        let half = f64::from((frame.resolution * 0.5) as f32);
        let origin = f64::from(frame.origin[axis]);
        [center - half - origin, center + half - origin]
    })
}

/// Lane masks of f64 comparisons, as four i32 lanes.
///
/// # Safety
/// Needs AVX2.
#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn narrow(mask: std::arch::x86_64::__m256d) -> std::arch::x86_64::__m128i {
    use std::arch::x86_64::*;
    let pairs = _mm256_castpd_ps(mask);
    let (low, high) = (
        _mm256_castps256_ps128(pairs),
        _mm256_extractf128_ps::<1>(pairs),
    );
    _mm_castps_si128(_mm_shuffle_ps::<0b10_00_10_00>(low, high))
}

// Both kernels choose the axis by its `t` being the least of the three, in the order z, y, x: the same as OctoMap's
// comparisons (x if t0 < t1 and t0 < t2, else y if t1 < t2, else z). A lane that has ended stays at the last voxel that it
// marked and marks it again.

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::{borders, Frame, Rays, FREE, RAYS};
    use std::arch::x86_64::*;

    /// Groups of eight rays, to hide the latency of the comparisons.
    const GROUPS: usize = RAYS / 8;

    /// SAFETY: needs AVX-512 F, DQ and VL; sound rays. Every store goes to `min(cell, last)` as an unsigned number, hence
    /// into the window.
    #[target_feature(enable = "avx512f,avx512dq,avx512vl")]
    pub unsafe fn trace(frame: &Frame, rays: &Rays, window: &mut [u8]) {
        let last = window.len() as i32 - 1;
        let out = window.as_mut_ptr();
        let borders = borders(frame);
        let dummy = _mm256_set1_epi32(last);
        let zero = _mm512_setzero_pd();
        let far = _mm512_set1_pd(f64::MAX);
        for first in (0..rays.cell.len()).step_by(RAYS) {
            let mut t = [[far; 3]; GROUPS];
            let mut dt = [[far; 3]; GROUPS];
            let mut step = [[_mm256_setzero_si256(); 3]; GROUPS];
            let mut cell = [dummy; GROUPS];
            let mut end = [dummy; GROUPS];
            let mut length = [zero; GROUPS];
            let mut exit = [zero; GROUPS];
            let mut active = [0u8; GROUPS];
            for g in 0..GROUPS {
                let i = first + g * 8;
                // SAFETY: all lists have a multiple of `RAYS` elements.
                let load = |v: &[f32]| unsafe { _mm256_loadu_ps(v.as_ptr().add(i)) };
                let d: [__m256; 3] = std::array::from_fn(|axis| {
                    _mm256_sub_ps(load(rays.end[axis]), _mm256_set1_ps(frame.origin[axis]))
                });
                // No fused operations: the sum must round as OctoMap's does.
                let squares = _mm256_add_ps(
                    _mm256_add_ps(_mm256_mul_ps(d[0], d[0]), _mm256_mul_ps(d[1], d[1])),
                    _mm256_mul_ps(d[2], d[2]),
                );
                let norm = _mm512_cvtpd_ps(_mm512_sqrt_pd(_mm512_cvtps_pd(squares)));
                length[g] = _mm512_cvtps_pd(norm);
                for axis in 0..3 {
                    let unit = _mm512_cvtps_pd(_mm256_div_ps(d[axis], norm));
                    let plus = _mm512_cmp_pd_mask::<_CMP_GT_OQ>(unit, zero);
                    let minus = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(unit, zero);
                    let border = _mm512_mask_blend_pd(
                        plus,
                        _mm512_set1_pd(borders[axis][0]),
                        _mm512_set1_pd(borders[axis][1]),
                    );
                    t[g][axis] = _mm512_mask_div_pd(far, plus | minus, border, unit);
                    dt[g][axis] = _mm512_mask_div_pd(
                        far,
                        plus | minus,
                        _mm512_set1_pd(frame.resolution),
                        _mm512_abs_pd(unit),
                    );
                    let stride = frame.strides[axis];
                    step[g][axis] = _mm256_mask_blend_epi32(
                        plus,
                        _mm256_set1_epi32(-stride),
                        _mm256_set1_epi32(stride),
                    );
                }
                // SAFETY: as above.
                end[g] = unsafe { _mm256_loadu_si256(rays.cell.as_ptr().add(i).cast()) };
                let start = _mm256_set1_epi32(frame.start_cell);
                // A ray that ends in the sensor's voxel passes no other.
                active[g] = _mm256_cmpneq_epi32_mask(start, end[g]);
                cell[g] = _mm256_mask_blend_epi32(active[g], dummy, start);
                exit[g] = _mm512_min_pd(_mm512_min_pd(t[g][0], t[g][1]), t[g][2]);
            }
            while active.iter().any(|a| *a != 0) {
                for g in 0..GROUPS {
                    let mut at = [0i32; 8];
                    // SAFETY: `at` holds eight i32; each target is at most `last`.
                    unsafe {
                        _mm256_storeu_si256(
                            at.as_mut_ptr().cast(),
                            _mm256_min_epu32(cell[g], dummy),
                        );
                        for c in at {
                            *out.add(c as usize) = FREE;
                        }
                    }
                    let z = _mm512_cmp_pd_mask::<_CMP_EQ_OQ>(t[g][2], exit[g]);
                    let y = _mm512_mask_cmp_pd_mask::<_CMP_EQ_OQ>(!z, t[g][1], exit[g]);
                    let x = !(y | z);
                    t[g][0] = _mm512_mask_add_pd(t[g][0], x, t[g][0], dt[g][0]);
                    t[g][1] = _mm512_mask_add_pd(t[g][1], y, t[g][1], dt[g][1]);
                    t[g][2] = _mm512_mask_add_pd(t[g][2], z, t[g][2], dt[g][2]);
                    let [sx, sy, sz] = step[g];
                    let along = _mm256_mask_mov_epi32(_mm256_mask_mov_epi32(sx, y, sy), z, sz);
                    let next = _mm256_add_epi32(cell[g], along);
                    exit[g] = _mm512_min_pd(_mm512_min_pd(t[g][0], t[g][1]), t[g][2]);
                    let inside = _mm256_mask_cmpneq_epi32_mask(active[g], next, end[g]);
                    active[g] = _mm512_mask_cmp_pd_mask::<_CMP_LE_OQ>(inside, exit[g], length[g]);
                    cell[g] = _mm256_mask_mov_epi32(cell[g], active[g], next);
                }
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{borders, narrow, Frame, Rays, FREE};
    use std::arch::x86_64::*;

    const GROUPS: usize = 2;

    /// SAFETY: needs AVX2; sound rays. Every store goes to `min(cell, last)` as an unsigned number, hence into the window.
    #[target_feature(enable = "avx2")]
    pub unsafe fn trace(frame: &Frame, rays: &Rays, window: &mut [u8]) {
        let last = window.len() as i32 - 1;
        let out = window.as_mut_ptr();
        let borders = borders(frame);
        let dummy = _mm_set1_epi32(last);
        let zero = _mm256_setzero_pd();
        let far = _mm256_set1_pd(f64::MAX);
        let magnitude = _mm256_castsi256_pd(_mm256_set1_epi64x(i64::MAX));
        for first in (0..rays.cell.len()).step_by(4 * GROUPS) {
            let mut t = [[far; 3]; GROUPS];
            let mut dt = [[far; 3]; GROUPS];
            let mut step = [[_mm_setzero_si128(); 3]; GROUPS];
            let mut cell = [dummy; GROUPS];
            let mut end = [dummy; GROUPS];
            let mut length = [zero; GROUPS];
            let mut exit = [zero; GROUPS];
            // All bits set in the lanes that still walk.
            let mut active = [_mm_setzero_si128(); GROUPS];
            for g in 0..GROUPS {
                let i = first + g * 4;
                // SAFETY: all lists have a multiple of `RAYS` elements.
                let load = |v: &[f32]| unsafe { _mm_loadu_ps(v.as_ptr().add(i)) };
                let d: [__m128; 3] = std::array::from_fn(|axis| {
                    _mm_sub_ps(load(rays.end[axis]), _mm_set1_ps(frame.origin[axis]))
                });
                let squares = _mm_add_ps(
                    _mm_add_ps(_mm_mul_ps(d[0], d[0]), _mm_mul_ps(d[1], d[1])),
                    _mm_mul_ps(d[2], d[2]),
                );
                let norm = _mm256_cvtpd_ps(_mm256_sqrt_pd(_mm256_cvtps_pd(squares)));
                length[g] = _mm256_cvtps_pd(norm);
                for axis in 0..3 {
                    let unit = _mm256_cvtps_pd(_mm_div_ps(d[axis], norm));
                    let plus = _mm256_cmp_pd::<_CMP_GT_OQ>(unit, zero);
                    let moves = _mm256_cmp_pd::<_CMP_NEQ_OQ>(unit, zero);
                    let border = _mm256_blendv_pd(
                        _mm256_set1_pd(borders[axis][0]),
                        _mm256_set1_pd(borders[axis][1]),
                        plus,
                    );
                    t[g][axis] = _mm256_blendv_pd(far, _mm256_div_pd(border, unit), moves);
                    let delta = _mm256_div_pd(
                        _mm256_set1_pd(frame.resolution),
                        _mm256_and_pd(unit, magnitude),
                    );
                    dt[g][axis] = _mm256_blendv_pd(far, delta, moves);
                    let stride = frame.strides[axis];
                    step[g][axis] = _mm_blendv_epi8(
                        _mm_set1_epi32(-stride),
                        _mm_set1_epi32(stride),
                        narrow(plus),
                    );
                }
                // SAFETY: as above.
                end[g] = unsafe { _mm_loadu_si128(rays.cell.as_ptr().add(i).cast()) };
                let start = _mm_set1_epi32(frame.start_cell);
                let still = _mm_cmpeq_epi32(start, end[g]);
                active[g] = _mm_xor_si128(still, _mm_set1_epi32(-1));
                cell[g] = _mm_blendv_epi8(start, dummy, still);
                exit[g] = _mm256_min_pd(_mm256_min_pd(t[g][0], t[g][1]), t[g][2]);
            }
            while active.iter().any(|a| _mm_testz_si128(*a, *a) == 0) {
                for g in 0..GROUPS {
                    let mut at = [0i32; 4];
                    // SAFETY: `at` holds four i32; each target is at most `last`.
                    unsafe {
                        _mm_storeu_si128(at.as_mut_ptr().cast(), _mm_min_epu32(cell[g], dummy));
                        for c in at {
                            *out.add(c as usize) = FREE;
                        }
                    }
                    let z = _mm256_cmp_pd::<_CMP_EQ_OQ>(t[g][2], exit[g]);
                    let y = _mm256_andnot_pd(z, _mm256_cmp_pd::<_CMP_EQ_OQ>(t[g][1], exit[g]));
                    // A step of zero leaves `t` as it is: no negative zeros here.
                    let yz = _mm256_or_pd(y, z);
                    t[g][0] = _mm256_add_pd(t[g][0], _mm256_andnot_pd(yz, dt[g][0]));
                    t[g][1] = _mm256_add_pd(t[g][1], _mm256_and_pd(y, dt[g][1]));
                    t[g][2] = _mm256_add_pd(t[g][2], _mm256_and_pd(z, dt[g][2]));
                    let [sx, sy, sz] = step[g];
                    let along = _mm_blendv_epi8(_mm_blendv_epi8(sx, sy, narrow(y)), sz, narrow(z));
                    let next = _mm_add_epi32(cell[g], along);
                    exit[g] = _mm256_min_pd(_mm256_min_pd(t[g][0], t[g][1]), t[g][2]);
                    let within = narrow(_mm256_cmp_pd::<_CMP_LE_OQ>(exit[g], length[g]));
                    let goes_on = _mm_andnot_si128(_mm_cmpeq_epi32(next, end[g]), within);
                    active[g] = _mm_and_si128(active[g], goes_on);
                    cell[g] = _mm_blendv_epi8(cell[g], next, active[g]);
                }
            }
        }
    }
}
