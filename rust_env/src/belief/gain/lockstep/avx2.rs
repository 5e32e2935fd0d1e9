//! Four rays a register.
use super::{Directions, Frame, RAYS};
use crate::belief::lockstep::narrow;
use std::arch::x86_64::*;

const GROUPS: usize = RAYS / 4;

/// For each set of four lanes the shuffle of bytes that moves them to the front.
static FRONT: [[i8; 16]; 16] = {
    let mut table = [[-1; 16]; 16];
    let mut set = 0;
    while set < 16 {
        let (mut lane, mut to) = (0, 0);
        while lane < 4 {
            if set >> lane & 1 == 1 {
                let mut byte = 0;
                while byte < 4 {
                    table[set][4 * to + byte] = (4 * lane + byte) as i8;
                    byte += 1;
                }
                to += 1;
            }
            lane += 1;
        }
        set += 1;
    }
    table
};

/// SAFETY: needs AVX2; see [`super::Walk`].
#[target_feature(enable = "avx2,popcnt")]
pub unsafe fn walk<const LIST: bool>(
    frame: &Frame,
    directions: &Directions,
    first: usize,
    [counted, opaque]: [u8; 2],
    out: *mut u32,
    counts: &mut [u32; RAYS],
) -> usize {
    let window = frame.window;
    let state: *const i32 = window.state.as_ptr().cast();
    let strides = window.strides();
    let zero = _mm256_setzero_pd();
    let none = _mm_setzero_si128();
    let far = _mm256_set1_pd(f64::MAX);
    let magnitude = _mm256_castsi256_pd(_mm256_set1_epi64x(i64::MAX));
    let range = _mm256_set1_pd(frame.max_range);
    let counted = _mm_set1_epi32(i32::from(counted));
    let opaque = _mm_set1_epi32(i32::from(opaque));
    let mut t = [[far; 3]; GROUPS];
    let mut dt = [[far; 3]; GROUPS];
    let mut step = [[none; 3]; GROUPS];
    let mut cell = [_mm_set1_epi32(window.index(frame.start) as i32); GROUPS];
    // All bits set in the lanes that still walk.
    let mut active = [none; GROUPS];
    let mut made = [none; GROUPS];
    for g in 0..GROUPS {
        let i = first + g * 4;
        if i >= directions.len() {
            break;
        }
        let lanes = (directions.len() - i).min(4);
        active[g] = _mm_cmpgt_epi32(_mm_set1_epi32(lanes as i32), _mm_setr_epi32(0, 1, 2, 3));
        for axis in 0..3 {
            // As in `Dda::new`.
            let center = (f64::from(frame.start[axis]) + 0.5) * frame.resolution;
            let half = f64::from((frame.resolution * 0.5) as f32);
            let origin = f64::from(frame.origin[axis]);
            let mut four = [0f32; 4];
            four[..lanes].copy_from_slice(&directions.axes[axis][i..i + lanes]);
            // SAFETY: four elements.
            let d = _mm256_cvtps_pd(unsafe { _mm_loadu_ps(four.as_ptr()) });
            let plus = _mm256_cmp_pd::<_CMP_GT_OQ>(d, zero);
            let moves = _mm256_cmp_pd::<_CMP_NEQ_OQ>(d, zero);
            let border = _mm256_blendv_pd(
                _mm256_set1_pd(center - half - origin),
                _mm256_set1_pd(center + half - origin),
                plus,
            );
            t[g][axis] = _mm256_blendv_pd(far, _mm256_div_pd(border, d), moves);
            let delta = _mm256_div_pd(
                _mm256_set1_pd(frame.resolution),
                _mm256_and_pd(d, magnitude),
            );
            dt[g][axis] = _mm256_blendv_pd(far, delta, moves);
            let stride = strides[axis] as i32;
            step[g][axis] = _mm_blendv_epi8(
                _mm_set1_epi32(-stride),
                _mm_set1_epi32(stride),
                narrow(plus),
            );
        }
    }
    let mut listed = 0;
    let mut row = 0;
    while active.iter().any(|a| _mm_testz_si128(*a, *a) == 0) {
        for g in 0..GROUPS {
            // SAFETY: see above; inactive lanes are not read, and each row has its room at `out`.
            let states = unsafe { _mm_mask_i32gather_epi32::<1>(none, state, cell[g], active[g]) };
            if LIST {
                // Inactive lanes read no state.
                let misses = _mm_cmpeq_epi32(_mm_and_si128(states, counted), none);
                let hits = !_mm_movemask_ps(_mm_castsi128_ps(misses)) & 15;
                unsafe {
                    let front = _mm_loadu_si128(FRONT[hits as usize].as_ptr().cast());
                    _mm_storeu_si128(out.add(listed).cast(), _mm_shuffle_epi8(cell[g], front));
                }
                listed += hits.count_ones() as usize;
            } else {
                unsafe { _mm_storeu_si128(out.add(row + g * 4).cast(), cell[g]) };
                made[g] = _mm_sub_epi32(made[g], active[g]);
            }
            let clear = _mm_cmpeq_epi32(_mm_and_si128(states, opaque), none);
            let [t0, t1, t2] = t[g];
            // The axis with the least `t`, of equal ones the last: the same as `Dda::advance`.
            let entry = _mm256_min_pd(_mm256_min_pd(t0, t1), t2);
            let z = _mm256_cmp_pd::<_CMP_EQ_OQ>(t2, entry);
            let y = _mm256_andnot_pd(z, _mm256_cmp_pd::<_CMP_EQ_OQ>(t1, entry));
            t[g][0] = _mm256_add_pd(t0, _mm256_andnot_pd(_mm256_or_pd(y, z), dt[g][0]));
            t[g][1] = _mm256_add_pd(t1, _mm256_and_pd(y, dt[g][1]));
            t[g][2] = _mm256_add_pd(t2, _mm256_and_pd(z, dt[g][2]));
            let [sx, sy, sz] = step[g];
            let along = _mm_blendv_epi8(_mm_blendv_epi8(sx, sy, narrow(y)), sz, narrow(z));
            cell[g] = _mm_add_epi32(cell[g], along);
            let within = narrow(_mm256_cmp_pd::<_CMP_LE_OQ>(entry, range));
            active[g] = _mm_and_si128(active[g], _mm_and_si128(clear, within));
        }
        row += RAYS;
    }
    for (g, made) in made.into_iter().enumerate() {
        // SAFETY: four counts a group.
        unsafe { _mm_storeu_si128(counts.as_mut_ptr().add(g * 4).cast(), made) };
    }
    listed
}
