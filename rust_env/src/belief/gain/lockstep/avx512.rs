//! Eight rays a register.
use super::{Directions, Frame, RAYS};
use std::arch::x86_64::*;

const GROUPS: usize = RAYS / 8;

/// SAFETY: needs AVX-512 F, DQ and VL; see [`super::Walk`].
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
            let d = unsafe { _mm256_maskz_loadu_ps(mask, directions.axes[axis].as_ptr().add(i)) };
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
                // Neighbours are often in the same voxel: the first of them is enough.
                let before = _mm256_alignr_epi32::<7>(cell[g], cell[g]);
                let same = _mm256_mask_cmpeq_epi32_mask(hits & (hits << 1), cell[g], before);
                let hits = hits ^ same;
                unsafe {
                    _mm256_storeu_si256(
                        out.add(listed).cast(),
                        _mm256_maskz_compress_epi32(hits, cell[g]),
                    )
                };
                listed += hits.count_ones() as usize;
            } else {
                unsafe { _mm256_storeu_si256(out.add(row + g * 8).cast(), cell[g]) };
                made[g] = _mm256_mask_add_epi32(made[g], active[g], made[g], _mm256_set1_epi32(1));
            }
            active[g] &= _mm256_testn_epi32_mask(states, opaque);
            let [t0, t1, t2] = t[g];
            // The axis with the least `t`, of equal ones the last: the same as `Dda::advance`.
            let entry = _mm512_min_pd(_mm512_min_pd(t0, t1), t2);
            let z = _mm512_cmp_pd_mask::<_CMP_EQ_OQ>(t2, entry);
            let y = _mm512_mask_cmp_pd_mask::<_CMP_EQ_OQ>(!z, t1, entry);
            let x = !(y | z);
            t[g][0] = _mm512_mask_add_pd(t0, x, t0, dt[g][0]);
            t[g][1] = _mm512_mask_add_pd(t1, y, t1, dt[g][1]);
            t[g][2] = _mm512_mask_add_pd(t2, z, t2, dt[g][2]);
            let [sx, sy, sz] = step[g];
            let along = _mm256_mask_mov_epi32(_mm256_mask_mov_epi32(sx, y, sy), z, sz);
            cell[g] = _mm256_add_epi32(cell[g], along);
            active[g] = _mm512_mask_cmp_pd_mask::<_CMP_LE_OQ>(active[g], entry, range);
        }
        row += RAYS;
    }
    for (g, made) in made.into_iter().enumerate() {
        // SAFETY: eight counts a group.
        unsafe { _mm256_storeu_si256(counts.as_mut_ptr().add(g * 8).cast(), made) };
    }
    listed
}
