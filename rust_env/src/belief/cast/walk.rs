//! The walks in lockstep. A lane that has ended takes the next ray, so that long rays do not keep others waiting.
use super::{Batch, Casts, Stops};
use crate::belief::lockstep::Lanes;

/// Walk all rays. Those that are stopped within the maximum range go to `stops`, those that start outside the window to
/// `others`; the rest meets nothing.
pub fn walk(lanes: Lanes, casts: &Casts, stops: &mut Stops, others: &mut Vec<usize>) {
    match lanes {
        Lanes::Scalar => others.extend(0..casts.origins.len()),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `Lanes` is only made where the features were detected.
        Lanes::Avx2 => unsafe { avx2::walk(casts, stops, others) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Lanes::Avx512 => unsafe { avx512::walk(casts, stops, others) },
    }
}

// Reads stay in the window: rays start inside of its border of stops, which is a brick thick, and move by one voxel at a time.

#[cfg(target_arch = "x86_64")]
mod avx512 {
    use super::{Batch, Casts, Stops};
    use std::arch::x86_64::*;

    const GROUPS: usize = 2;
    /// A group takes new rays once so many of its lanes are empty: fewer would cost more than they bring.
    const EMPTY_LANES: u32 = 3;

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,popcnt")]
    pub fn walk(casts: &Casts, stops: &mut Stops, others: &mut Vec<usize>) {
        let zero = _mm512_setzero_pd();
        let none = _mm256_setzero_si256();
        let range = _mm512_set1_pd(casts.max_range);
        let window = casts.window.stops.as_ptr();
        let mut t = [[zero; 3]; GROUPS];
        let mut dt = [[zero; 3]; GROUPS];
        let mut step = [[none; 3]; GROUPS];
        let mut bit = [none; GROUPS];
        let mut ray = [none; GROUPS];
        let mut entry = [zero; GROUPS];
        let mut active = [0u8; GROUPS];
        let mut batch = Batch::EMPTY;
        let (mut next, mut taken) = (0, 0);
        loop {
            let mut any = 0;
            for g in 0..GROUPS {
                if 8 - active[g].count_ones() >= EMPTY_LANES {
                    if taken == batch.len && next < casts.origins.len() {
                        casts.prepare(next, &mut batch, others);
                        next += super::super::BATCH;
                        taken = 0;
                    }
                    let mut lanes = !active[g];
                    while lanes.count_ones() as usize > batch.len - taken {
                        lanes &= lanes - 1;
                    }
                    if lanes != 0 {
                        // SAFETY: reads as many elements of the batch as there are lanes.
                        unsafe {
                            for axis in 0..3 {
                                t[g][axis] = _mm512_mask_expandloadu_pd(
                                    t[g][axis],
                                    lanes,
                                    batch.t[axis].as_ptr().add(taken),
                                );
                                dt[g][axis] = _mm512_mask_expandloadu_pd(
                                    dt[g][axis],
                                    lanes,
                                    batch.dt[axis].as_ptr().add(taken),
                                );
                                step[g][axis] = _mm256_mask_expandloadu_epi32(
                                    step[g][axis],
                                    lanes,
                                    batch.step[axis].as_ptr().add(taken),
                                );
                            }
                            let bits = batch.bit.as_ptr().add(taken);
                            bit[g] = _mm256_mask_expandloadu_epi32(bit[g], lanes, bits);
                            let rays = batch.ray.as_ptr().add(taken);
                            ray[g] = _mm256_mask_expandloadu_epi32(ray[g], lanes, rays);
                        }
                        entry[g] = _mm512_mask_mov_pd(entry[g], lanes, zero);
                        active[g] |= lanes;
                        taken += lanes.count_ones() as usize;
                    }
                }
                any |= active[g];
                // SAFETY: the words of active lanes' bits are in the window; others are not read.
                let words = unsafe {
                    _mm256_mmask_i32gather_epi32::<4>(
                        none,
                        active[g],
                        _mm256_srli_epi32::<5>(bit[g]),
                        window.cast(),
                    )
                };
                // Rotates by the number modulo 32.
                let stop = _mm256_mask_test_epi32_mask(
                    active[g],
                    _mm256_rorv_epi32(words, bit[g]),
                    _mm256_set1_epi32(1),
                );
                if stop != 0 {
                    let (rays, bits, entries) = stops.room(8);
                    // Whole registers are written; what is too much will be overwritten.
                    let entry = _mm512_cvtpd_ps(entry[g]);
                    // SAFETY: eight elements each.
                    unsafe {
                        let r = _mm256_maskz_compress_epi32(stop, ray[g]);
                        _mm256_storeu_si256(rays.as_mut_ptr().cast(), r);
                        let b = _mm256_maskz_compress_epi32(stop, bit[g]);
                        _mm256_storeu_si256(bits.as_mut_ptr().cast(), b);
                        let e = _mm256_maskz_compress_ps(stop, entry);
                        _mm256_storeu_ps(entries.as_mut_ptr(), e);
                    }
                    stops.len += stop.count_ones() as usize;
                    active[g] ^= stop;
                }
                let [t0, t1, t2] = t[g];
                let least = _mm512_min_pd(_mm512_min_pd(t0, t1), t2);
                let z = _mm512_cmp_pd_mask::<_CMP_EQ_OQ>(t2, least);
                let y = _mm512_mask_cmp_pd_mask::<_CMP_EQ_OQ>(!z, t1, least);
                let x = !(y | z);
                t[g][0] = _mm512_mask_add_pd(t0, x, t0, dt[g][0]);
                t[g][1] = _mm512_mask_add_pd(t1, y, t1, dt[g][1]);
                t[g][2] = _mm512_mask_add_pd(t2, z, t2, dt[g][2]);
                let [sx, sy, sz] = step[g];
                let along = _mm256_mask_mov_epi32(_mm256_mask_mov_epi32(sx, y, sy), z, sz);
                bit[g] = _mm256_add_epi32(bit[g], along);
                entry[g] = least;
                active[g] = _mm512_mask_cmp_pd_mask::<_CMP_LE_OQ>(active[g], least, range);
            }
            if any == 0 && taken == batch.len && next >= casts.origins.len() {
                return;
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{Batch, Casts, Stops};
    use crate::belief::lockstep::narrow;
    use std::arch::x86_64::*;

    const GROUPS: usize = 2;
    const WIDTH: usize = 4 * GROUPS;

    /// Without expanding loads, all lanes of a group of rays start together.
    #[target_feature(enable = "avx2,popcnt")]
    pub fn walk(casts: &Casts, stops: &mut Stops, others: &mut Vec<usize>) {
        let mut batch = Batch::EMPTY;
        for next in (0..casts.origins.len()).step_by(super::super::BATCH) {
            casts.prepare(next, &mut batch, others);
            for first in (0..batch.len).step_by(WIDTH) {
                group(casts, &batch, first, stops);
            }
        }
    }

    #[target_feature(enable = "avx2,popcnt")]
    fn group(casts: &Casts, batch: &Batch, first: usize, stops: &mut Stops) {
        const { assert!(super::super::BATCH.is_multiple_of(WIDTH)) };
        let zero = _mm256_setzero_pd();
        let one = _mm_set1_epi32(1);
        let range = _mm256_set1_pd(casts.max_range);
        let window: *const i32 = casts.window.stops.as_ptr().cast();
        let mut t = [[zero; 3]; GROUPS];
        let mut dt = [[zero; 3]; GROUPS];
        let mut step = [[one; 3]; GROUPS];
        let mut bit = [one; GROUPS];
        let mut entry = [zero; GROUPS];
        // All bits set in the lanes that still walk.
        let mut active = [one; GROUPS];
        for g in 0..GROUPS {
            let i = first + 4 * g;
            // SAFETY: a batch has a multiple of `WIDTH` elements.
            unsafe {
                for axis in 0..3 {
                    t[g][axis] = _mm256_loadu_pd(batch.t[axis].as_ptr().add(i));
                    dt[g][axis] = _mm256_loadu_pd(batch.dt[axis].as_ptr().add(i));
                    step[g][axis] = _mm_loadu_si128(batch.step[axis].as_ptr().add(i).cast());
                }
                bit[g] = _mm_loadu_si128(batch.bit.as_ptr().add(i).cast());
            }
            let left = _mm_set1_epi32((batch.len - i.min(batch.len)) as i32);
            active[g] = _mm_cmpgt_epi32(left, _mm_setr_epi32(0, 1, 2, 3));
        }
        while active.iter().any(|a| _mm_testz_si128(*a, *a) == 0) {
            for g in 0..GROUPS {
                // SAFETY: the words of active lanes' bits are in the window; others are not read.
                let words = unsafe {
                    _mm_mask_i32gather_epi32::<4>(
                        _mm_setzero_si128(),
                        window,
                        _mm_srli_epi32::<5>(bit[g]),
                        active[g],
                    )
                };
                let within = _mm_and_si128(bit[g], _mm_set1_epi32(31));
                let marks = _mm_and_si128(_mm_srlv_epi32(words, within), one);
                let stop = _mm_cmpeq_epi32(marks, one);
                let mut lanes = _mm_movemask_ps(_mm_castsi128_ps(stop));
                if lanes != 0 {
                    let (mut bits, mut entries) = ([0i32; 4], [0f32; 4]);
                    // SAFETY: four elements each.
                    unsafe {
                        _mm_storeu_si128(bits.as_mut_ptr().cast(), bit[g]);
                        _mm_storeu_ps(entries.as_mut_ptr(), _mm256_cvtpd_ps(entry[g]));
                    }
                    while lanes != 0 {
                        let lane = lanes.trailing_zeros() as usize;
                        lanes &= lanes - 1;
                        let ray = batch.ray[first + 4 * g + lane];
                        stops.push(ray, bits[lane], entries[lane]);
                    }
                    active[g] = _mm_andnot_si128(stop, active[g]);
                }
                let [t0, t1, t2] = t[g];
                let least = _mm256_min_pd(_mm256_min_pd(t0, t1), t2);
                let z = _mm256_cmp_pd::<_CMP_EQ_OQ>(t2, least);
                let y = _mm256_andnot_pd(z, _mm256_cmp_pd::<_CMP_EQ_OQ>(t1, least));
                t[g][0] = _mm256_add_pd(t0, _mm256_andnot_pd(_mm256_or_pd(y, z), dt[g][0]));
                t[g][1] = _mm256_add_pd(t1, _mm256_and_pd(y, dt[g][1]));
                t[g][2] = _mm256_add_pd(t2, _mm256_and_pd(z, dt[g][2]));
                let [sx, sy, sz] = step[g];
                let along = _mm_blendv_epi8(_mm_blendv_epi8(sx, sy, narrow(y)), sz, narrow(z));
                bit[g] = _mm_add_epi32(bit[g], along);
                entry[g] = least;
                let within = narrow(_mm256_cmp_pd::<_CMP_LE_OQ>(least, range));
                active[g] = _mm_and_si128(active[g], within);
            }
        }
    }
}
