//! Exact ray tracing of a whole image, eight rays in lockstep (AVX-512) or four (AVX2).
//!
//! The arithmetic is that of [`super::integrate`]'s scalar walk, operation for operation, so that both mark the same
//! voxels; a test compares them. Voxels are marked in a window of bytes around the sensor, x fastest: plain stores of
//! equal values cannot conflict, and a voxel's number changes by a constant per step along an axis.
use crate::geometry::{IVec3, Vec3};
use crate::instructions::{widest, Instructions};

/// A voxel that a ray passed, and one in which a ray ended.
pub const FREE: u8 = 1;
pub const HIT: u8 = 2;
/// Largest window (bytes); larger images take the scalar path.
pub const MAX_WINDOW: u64 = 1 << 26;

/// The rays of one image: from the sensor to `end`, whose voxel is number `cell` of the window.
#[derive(Clone, Default)]
pub struct Rays {
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub z: Vec<f32>,
    pub cell: Vec<i32>,
}

impl Rays {
    pub fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.z.clear();
        self.cell.clear();
    }

    #[inline]
    pub fn push(&mut self, end: Vec3, cell: i32) {
        self.x.push(end.x);
        self.y.push(end.y);
        self.z.push(end.z);
        self.cell.push(cell);
    }

    pub fn len(&self) -> usize {
        self.cell.len()
    }

    pub fn is_empty(&self) -> bool {
        self.cell.is_empty()
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
        all.filter(allowed).last().unwrap_or(Self::Scalar)
    }

    /// The widest kind that this machine can run.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
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
    if window.is_empty() || window.len() > i32::MAX as usize {
        return false;
    }
    match lanes {
        Lanes::Scalar => false,
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the caller detected the features (`Lanes` is only made by `detect` and `available`).
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

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::{borders, Frame, Rays, FREE};
    use std::arch::x86_64::*;

    /// Groups of eight rays that are walked together, to hide the latency of the comparisons.
    const GROUPS: usize = 2;

    /// SAFETY: needs AVX-512 F, DQ and VL. Every store goes to `min(cell, last)` as an unsigned number, hence into the
    /// window.
    #[target_feature(enable = "avx512f,avx512dq,avx512vl")]
    pub unsafe fn trace(frame: &Frame, rays: &Rays, window: &mut [u8]) {
        let last = window.len() as i32 - 1;
        let out = window.as_mut_ptr();
        let n = rays.len();
        let borders = borders(frame);
        let dummy = _mm256_set1_epi32(last);
        let zero = _mm512_setzero_pd();
        let far = _mm512_set1_pd(f64::MAX);
        let mut first = 0;
        while first < n {
            let mut t = [[far; 3]; GROUPS];
            let mut dt = [[far; 3]; GROUPS];
            let mut step = [[_mm256_setzero_si256(); 3]; GROUPS];
            let mut cell = [dummy; GROUPS];
            let mut end = [dummy; GROUPS];
            let mut length = [zero; GROUPS];
            let mut active = [0u8; GROUPS];
            for g in 0..GROUPS {
                let i = first + g * 8;
                if i >= n {
                    break;
                }
                let lanes = (n - i).min(8);
                let mask = ((1u32 << lanes) - 1) as u8;
                // SAFETY: masked loads touch only the `lanes` elements that exist.
                let load = |v: &[f32]| unsafe { _mm256_maskz_loadu_ps(mask, v.as_ptr().add(i)) };
                let sub = |v, o: f32| _mm256_sub_ps(v, _mm256_set1_ps(o));
                let d = [
                    sub(load(&rays.x), frame.origin.x),
                    sub(load(&rays.y), frame.origin.y),
                    sub(load(&rays.z), frame.origin.z),
                ];
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
                // SAFETY: masked as above.
                end[g] = unsafe { _mm256_mask_loadu_epi32(dummy, mask, rays.cell.as_ptr().add(i)) };
                cell[g] = _mm256_set1_epi32(frame.start_cell);
                // A ray that ends in the sensor's voxel passes no other.
                active[g] = mask & _mm256_cmpneq_epi32_mask(cell[g], end[g]);
            }
            while active.iter().any(|a| *a != 0) {
                for g in 0..GROUPS {
                    let mut at = [0i32; 8];
                    let target =
                        _mm256_min_epu32(_mm256_mask_blend_epi32(active[g], dummy, cell[g]), dummy);
                    // SAFETY: `at` holds eight i32; each target is at most `last`.
                    unsafe {
                        _mm256_storeu_si256(at.as_mut_ptr().cast(), target);
                        for c in at {
                            *out.add(c as usize) = FREE;
                        }
                    }
                    let [t0, t1, t2] = t[g];
                    let below01 = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(t0, t1);
                    let below02 = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(t0, t2);
                    let below12 = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(t1, t2);
                    let x = below01 & below02;
                    let y = !below01 & below12;
                    let z = !(x | y);
                    t[g][0] = _mm512_mask_add_pd(t0, x, t0, dt[g][0]);
                    t[g][1] = _mm512_mask_add_pd(t1, y, t1, dt[g][1]);
                    t[g][2] = _mm512_mask_add_pd(t2, z, t2, dt[g][2]);
                    cell[g] = _mm256_mask_add_epi32(cell[g], x, cell[g], step[g][0]);
                    cell[g] = _mm256_mask_add_epi32(cell[g], y, cell[g], step[g][1]);
                    cell[g] = _mm256_mask_add_epi32(cell[g], z, cell[g], step[g][2]);
                    let exit = _mm512_min_pd(_mm512_min_pd(t[g][0], t[g][1]), t[g][2]);
                    active[g] &= _mm256_cmpneq_epi32_mask(cell[g], end[g])
                        & _mm512_cmp_pd_mask::<_CMP_LE_OQ>(exit, length[g]);
                }
            }
            first += GROUPS * 8;
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{borders, Frame, Rays, FREE};
    use std::arch::x86_64::*;

    const GROUPS: usize = 2;

    /// Lane masks of f64 comparisons, as four i32 lanes.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn narrow(mask: __m256d) -> __m128i {
        let pairs = _mm256_castpd_si256(mask);
        let even = _mm256_permutevar8x32_epi32(pairs, _mm256_setr_epi32(0, 2, 4, 6, 0, 2, 4, 6));
        _mm256_castsi256_si128(even)
    }

    /// SAFETY: needs AVX2. Every store goes to `min(cell, last)` as an unsigned number, hence into the window.
    #[target_feature(enable = "avx2")]
    pub unsafe fn trace(frame: &Frame, rays: &Rays, window: &mut [u8]) {
        let last = window.len() as i32 - 1;
        let out = window.as_mut_ptr();
        let n = rays.len();
        let borders = borders(frame);
        let dummy = _mm_set1_epi32(last);
        let zero = _mm256_setzero_pd();
        let far = _mm256_set1_pd(f64::MAX);
        let magnitude = _mm256_castsi256_pd(_mm256_set1_epi64x(i64::MAX));
        let mut first = 0;
        while first < n {
            let mut t = [[far; 3]; GROUPS];
            let mut dt = [[far; 3]; GROUPS];
            let mut step = [[_mm_setzero_si128(); 3]; GROUPS];
            let mut cell = [dummy; GROUPS];
            let mut end = [dummy; GROUPS];
            let mut length = [zero; GROUPS];
            // All bits set in the lanes that still walk.
            let mut active = [_mm_setzero_si128(); GROUPS];
            for g in 0..GROUPS {
                let i = first + g * 4;
                if i >= n {
                    break;
                }
                let lanes = (n - i).min(4);
                let mut ends = [[0f32; 4]; 3];
                let mut cells = [last; 4];
                let mut exists = [0i32; 4];
                for l in 0..lanes {
                    ends[0][l] = rays.x[i + l];
                    ends[1][l] = rays.y[i + l];
                    ends[2][l] = rays.z[i + l];
                    cells[l] = rays.cell[i + l];
                    exists[l] = -1;
                }
                // SAFETY: all arrays hold four elements.
                let d: [__m128; 3] = std::array::from_fn(|a| unsafe {
                    _mm_sub_ps(_mm_loadu_ps(ends[a].as_ptr()), _mm_set1_ps(frame.origin[a]))
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
                unsafe {
                    end[g] = _mm_loadu_si128(cells.as_ptr().cast());
                    active[g] = _mm_loadu_si128(exists.as_ptr().cast());
                }
                cell[g] = _mm_set1_epi32(frame.start_cell);
                active[g] = _mm_andnot_si128(_mm_cmpeq_epi32(cell[g], end[g]), active[g]);
            }
            while active.iter().any(|a| _mm_testz_si128(*a, *a) == 0) {
                for g in 0..GROUPS {
                    let mut at = [0i32; 4];
                    let target = _mm_min_epu32(_mm_blendv_epi8(dummy, cell[g], active[g]), dummy);
                    // SAFETY: `at` holds four i32; each target is at most `last`.
                    unsafe {
                        _mm_storeu_si128(at.as_mut_ptr().cast(), target);
                        for c in at {
                            *out.add(c as usize) = FREE;
                        }
                    }
                    let [t0, t1, t2] = t[g];
                    let below01 = _mm256_cmp_pd::<_CMP_LT_OQ>(t0, t1);
                    let below02 = _mm256_cmp_pd::<_CMP_LT_OQ>(t0, t2);
                    let below12 = _mm256_cmp_pd::<_CMP_LT_OQ>(t1, t2);
                    let x = _mm256_and_pd(below01, below02);
                    let y = _mm256_andnot_pd(below01, below12);
                    let all = _mm256_castsi256_pd(_mm256_set1_epi64x(-1));
                    let z = _mm256_andnot_pd(_mm256_or_pd(x, y), all);
                    for (axis, chosen) in [x, y, z].into_iter().enumerate() {
                        t[g][axis] = _mm256_blendv_pd(
                            t[g][axis],
                            _mm256_add_pd(t[g][axis], dt[g][axis]),
                            chosen,
                        );
                        cell[g] =
                            _mm_add_epi32(cell[g], _mm_and_si128(step[g][axis], narrow(chosen)));
                    }
                    let exit = _mm256_min_pd(_mm256_min_pd(t[g][0], t[g][1]), t[g][2]);
                    let within = narrow(_mm256_cmp_pd::<_CMP_LE_OQ>(exit, length[g]));
                    let goes_on = _mm_andnot_si128(_mm_cmpeq_epi32(cell[g], end[g]), within);
                    active[g] = _mm_and_si128(active[g], goes_on);
                }
            }
            first += GROUPS * 4;
        }
    }
}
