//! Walking a view's rays through a field of utilities: thirty-two in lockstep (AVX-512), or one by one, with the same arithmetic.
use super::{Field, UNEXPLORED, UNFILLED, WALL};
use crate::belief::lockstep::Lanes;
use crate::belief::ray_walk::Dda;
use crate::geometry::{IVec3, Mat3, Vec3};

/// Rays walked together.
const RAYS: usize = 32;

/// Unit directions in the world, by axis.
#[derive(Default)]
pub struct Rays {
    axes: [Vec<f32>; 3],
}

impl Rays {
    pub fn turn(&mut self, rotation: &Mat3, directions: &[Vec3]) {
        for (axis, out) in self.axes.iter_mut().enumerate() {
            out.clear();
            out.extend(
                directions
                    .iter()
                    .map(|d| super::super::rays::turned(rotation, *d)[axis]),
            );
        }
    }

    fn len(&self) -> usize {
        self.axes[0].len()
    }
}

/// What all rays of a view share.
pub struct Walk {
    /// Change of the index per step along x, y, z.
    pub strides: [i32; 3],
    /// Index of the camera's voxel.
    pub start: i32,
    /// More steps no ray can make.
    pub steps: usize,
    pub key: IVec3,
    pub origin: Vec3,
    pub resolution: f64,
    pub near: f64,
    pub max_range: f64,
}

impl Walk {
    /// The mean utility of the rays; all ways give the same bits. `fill` fills the brick of an index of the field.
    pub fn mean(
        &self,
        lanes: Lanes,
        rays: &Rays,
        field: &mut Field,
        fill: impl Fn(&mut Field, usize),
    ) -> f64 {
        if rays.len() == 0 {
            return 0.0;
        }
        let mut sum = 0.0;
        for first in (0..rays.len()).step_by(RAYS) {
            let count = (rays.len() - first).min(RAYS);
            let utilities = self.together(lanes, rays, first, field, &fill);
            for utility in utilities.iter().take(count) {
                sum += f64::from(*utility);
            }
        }
        sum / rays.len() as f64
    }

    fn together(
        &self,
        lanes: Lanes,
        rays: &Rays,
        first: usize,
        field: &mut Field,
        fill: &impl Fn(&mut Field, usize),
    ) -> [f32; RAYS] {
        #[cfg(target_arch = "x86_64")]
        if lanes == Lanes::Avx512 && field.values.len() < i32::MAX as usize {
            // SAFETY: the caller detected the features; see `avx512::walk` on reads.
            return unsafe { avx512::walk(self, rays, first, field, fill) };
        }
        let _ = lanes;
        std::array::from_fn(|i| {
            if first + i >= rays.len() {
                return 0.0;
            }
            let [x, y, z] = [0, 1, 2].map(|a| rays.axes[a][first + i]);
            self.one(Vec3::new(x, y, z), field, fill)
        })
    }

    fn one(&self, direction: Vec3, field: &mut Field, fill: &impl Fn(&mut Field, usize)) -> f32 {
        let mut dda = Dda::new(self.resolution, self.key, self.origin, direction);
        let mut at = self.start;
        let (mut sum, mut count) = (0f32, 0u32);
        let mut entry = 0.0;
        for _ in 0..self.steps {
            let there = |field: &Field| field.values.get(at as usize).copied().unwrap_or(WALL);
            let mut value = there(field);
            if value == UNFILLED {
                fill(field, at as usize);
                value = there(field);
            }
            if entry >= self.near {
                if value == UNEXPLORED {
                    return 1.0;
                }
                if value.abs() <= 1.0 {
                    sum += value.abs();
                    count += 1;
                }
            }
            if value.is_sign_negative() {
                break;
            }
            let before = dda.key;
            entry = dda.advance();
            let moved = dda.key - before;
            at += moved.x * self.strides[0] + moved.y * self.strides[1] + moved.z * self.strides[2];
            if entry > self.max_range {
                break;
            }
        }
        if count == 0 {
            0.0
        } else {
            sum / count as f32
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::{Field, Rays, Walk, RAYS, UNEXPLORED, UNFILLED};
    use std::arch::x86_64::*;

    const GROUPS: usize = RAYS / 8;

    /// SAFETY: needs AVX-512 F, DQ and VL. Gathers read at `min(index, last)` as unsigned numbers, hence in the field.
    #[target_feature(enable = "avx512f,avx512dq,avx512vl")]
    pub unsafe fn walk(
        walk: &Walk,
        rays: &Rays,
        first: usize,
        field: &mut Field,
        fill: &impl Fn(&mut Field, usize),
    ) -> [f32; RAYS] {
        let last = _mm256_set1_epi32(field.values.len() as i32 - 1);
        let unfilled = _mm256_set1_ps(UNFILLED);
        let zero = _mm512_setzero_pd();
        let far = _mm512_set1_pd(f64::MAX);
        let range = _mm512_set1_pd(walk.max_range);
        let near = _mm512_set1_pd(walk.near);
        let unexplored = _mm256_set1_ps(UNEXPLORED);
        let one = _mm256_set1_ps(1.0);
        let sign = _mm256_set1_epi32(i32::MIN);
        let mut t = [[far; 3]; GROUPS];
        let mut dt = [[far; 3]; GROUPS];
        let mut step = [[_mm256_setzero_si256(); 3]; GROUPS];
        let mut cell = [_mm256_set1_epi32(walk.start); GROUPS];
        let mut entry = [zero; GROUPS];
        let mut active = [0u8; GROUPS];
        let mut new = [0u8; GROUPS];
        let mut sum = [_mm256_setzero_ps(); GROUPS];
        let mut count = [_mm256_setzero_ps(); GROUPS];
        for g in 0..GROUPS {
            let i = first + g * 8;
            if i >= rays.len() {
                break;
            }
            let lanes = (rays.len() - i).min(8);
            let mask = ((1u32 << lanes) - 1) as u8;
            active[g] = mask;
            for axis in 0..3 {
                // As in `Dda::new`.
                let center = (f64::from(walk.key[axis]) + 0.5) * walk.resolution;
                let half = f64::from((walk.resolution * 0.5) as f32);
                let origin = f64::from(walk.origin[axis]);
                // SAFETY: the masked load touches only the `lanes` elements that exist.
                let d = unsafe { _mm256_maskz_loadu_ps(mask, rays.axes[axis].as_ptr().add(i)) };
                let d = _mm512_cvtps_pd(d);
                let plus = _mm512_cmp_pd_mask::<_CMP_GT_OQ>(d, zero);
                let minus = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(d, zero);
                let border = _mm512_mask_blend_pd(
                    plus,
                    _mm512_set1_pd(center - half - origin),
                    _mm512_set1_pd(center + half - origin),
                );
                t[g][axis] = _mm512_mask_div_pd(far, plus | minus, border, d);
                let length = _mm512_abs_pd(d);
                let resolution = _mm512_set1_pd(walk.resolution);
                dt[g][axis] = _mm512_mask_div_pd(far, plus | minus, resolution, length);
                let stride = walk.strides[axis];
                step[g][axis] = _mm256_mask_blend_epi32(
                    plus,
                    _mm256_set1_epi32(-stride),
                    _mm256_set1_epi32(stride),
                );
            }
        }
        for _ in 0..walk.steps {
            if active == [0; GROUPS] {
                break;
            }
            for g in 0..GROUPS {
                let at = _mm256_min_epu32(cell[g], last);
                let gather = |field: &Field| {
                    let values = field.values.as_ptr();
                    // SAFETY: inactive lanes are not read, the others within the field, whose length does not change.
                    unsafe {
                        _mm256_mmask_i32gather_ps::<4>(_mm256_setzero_ps(), active[g], at, values)
                    }
                };
                let mut value = gather(field);
                let mut missing = _mm256_mask_cmp_ps_mask::<_CMP_EQ_OQ>(active[g], value, unfilled);
                if missing != 0 {
                    let mut cells = [0u32; 8];
                    // SAFETY: eight numbers.
                    unsafe { _mm256_storeu_si256(cells.as_mut_ptr().cast(), at) };
                    while missing != 0 {
                        let cell = cells[missing.trailing_zeros() as usize] as usize;
                        missing &= missing - 1;
                        if field.values[cell] == UNFILLED {
                            fill(field, cell);
                        }
                    }
                    value = gather(field);
                }
                let within = active[g] & _mm512_cmp_pd_mask::<_CMP_GE_OQ>(entry[g], near);
                let open = _mm256_mask_cmp_ps_mask::<_CMP_EQ_OQ>(within, value, unexplored);
                new[g] |= open;
                let utility = _mm256_andnot_ps(_mm256_castsi256_ps(sign), value);
                let counted = _mm256_mask_cmp_ps_mask::<_CMP_LE_OQ>(within, utility, one);
                sum[g] = _mm256_mask_add_ps(sum[g], counted, sum[g], utility);
                count[g] = _mm256_mask_add_ps(count[g], counted, count[g], one);
                let opaque = _mm256_movepi32_mask(_mm256_castps_si256(value));
                active[g] &= !(open | opaque);
                // The same comparisons as `Dda::advance`.
                let [t0, t1, t2] = t[g];
                let below01 = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(t0, t1);
                let below02 = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(t0, t2);
                let below12 = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(t1, t2);
                let x = below01 & below02;
                let y = !below01 & below12;
                let z = !(x | y);
                entry[g] = _mm512_min_pd(_mm512_min_pd(t0, t1), t2);
                t[g][0] = _mm512_mask_add_pd(t0, x, t0, dt[g][0]);
                t[g][1] = _mm512_mask_add_pd(t1, y, t1, dt[g][1]);
                t[g][2] = _mm512_mask_add_pd(t2, z, t2, dt[g][2]);
                cell[g] = _mm256_mask_add_epi32(cell[g], x, cell[g], step[g][0]);
                cell[g] = _mm256_mask_add_epi32(cell[g], y, cell[g], step[g][1]);
                cell[g] = _mm256_mask_add_epi32(cell[g], z, cell[g], step[g][2]);
                active[g] &= _mm512_cmp_pd_mask::<_CMP_LE_OQ>(entry[g], range);
            }
        }
        let mut out = [0f32; RAYS];
        for g in 0..GROUPS {
            let some = _mm256_cmp_ps_mask::<_CMP_GT_OQ>(count[g], _mm256_setzero_ps());
            let mean = _mm256_maskz_div_ps(some, sum[g], count[g]);
            let utility = _mm256_mask_blend_ps(new[g], mean, one);
            // SAFETY: eight values a group.
            unsafe { _mm256_storeu_ps(out.as_mut_ptr().add(g * 8), utility) };
        }
        out
    }
}
