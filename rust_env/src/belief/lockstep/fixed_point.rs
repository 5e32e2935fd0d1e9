//! The walk in 32-bit fixed point, as far as it is certain to be OctoMap's.
//!
//! A ray is `ONE` units long. Which border comes next is certain if the two nearest ones are further apart than rounding can
//! have moved them; where they are not, or where the ray's length is as near, the ray is *doubtful* and is left to the exact
//! walk. What was marked before stands: it is the beginning of the exact walk.
use super::{Frame, Rays, FREE, RAYS};

/// Length of a ray. Twice as much is still a number.
pub const ONE: i32 = 1 << 30;

/// A few millionths of a ray.
const NEAR_END: i32 = 1 << 12;

/// The distance, in units, from which on an order is certain after `steps` steps. All numbers are rounded, and each axis adds
/// up at most `steps` of them, so that a border is off by at most half a unit for each, and one for its first; two borders
/// by that in all, as their steps together are at most `steps`.
pub fn margin(steps: i32) -> i32 {
    steps / 2 + 3
}

/// One source for all instruction sets; see [`super`]. `mark` is called with the numbers of voxels that are free, or `last`.
#[inline(always)]
pub fn trace(
    frame: &Frame,
    rays: &Rays,
    last: i32,
    doubtful: &mut Vec<u32>,
    mut mark: impl FnMut(&[i32; RAYS]),
) {
    let margin = margin(frame.max_steps);
    let borders = frame.borders();
    let voxels_a_unit = 1.0 / (frame.resolution * f64::from(ONE));
    for first in (0..rays.cell.len()).step_by(RAYS) {
        let (unit, length) = rays.directions(frame, first);
        let mut skip = [0.0; RAYS];
        skip.copy_from_slice(&rays.skip[first..first + RAYS]);
        // Units a metre, and voxels a unit along the ray; where the walk begins, in units.
        let (mut scale, mut voxels, mut from) = ([0.0f64; RAYS], [0.0f64; RAYS], [0i32; RAYS]);
        for i in 0..RAYS {
            scale[i] = f64::from(ONE) / f64::from(length[i]);
            voxels[i] = f64::from(length[i]) * voxels_a_unit;
            from[i] = rounded(f64::from(skip[i]) * scale[i], f64::from(ONE));
        }
        let mut cell = [frame.start_cell; RAYS];
        // All bits set where the first voxel is certain; never right before the end, which may lie beyond the last voxel by a
        // rounding.
        let mut begins = from.map(|from| mask(from <= ONE - NEAR_END));
        let (mut t, mut dt) = ([[0i32; RAYS]; 3], [[0i32; RAYS]; 3]);
        let mut step = [[0i32; RAYS]; 3];
        for axis in 0..3 {
            let [minus_border, plus_border] = borders[axis];
            let stride = frame.strides[axis];
            let (t, dt, step) = (&mut t[axis], &mut dt[axis], &mut step[axis]);
            for i in 0..RAYS {
                let u = unit[axis][i];
                let plus = u > 0.0;
                let border = if plus { plus_border } else { minus_border };
                let units = scale[i] / u;
                // No border is met along an axis on which the ray does not move.
                let t0 = if plus | (u < 0.0) {
                    border * units
                } else {
                    f64::INFINITY
                };
                // The sensor may lie a rounding beyond its voxel's border: units cannot say how far.
                begins[i] &= mask(t0 >= 0.0);
                t[i] = rounded(t0, f64::from(i32::MAX));
                dt[i] = rounded((frame.resolution * units).abs(), f64::from(ONE - 1));
                step[i] = if plus { stride } else { -stride };
            }
            if from == [0; RAYS] {
                continue;
            }
            // Borders up to the beginning are passed at once: the same sum, in one operation.
            for i in 0..RAYS {
                let beyond = from[i].wrapping_sub(t[i]);
                let each = (unit[axis][i].abs() * voxels[i]) as f32;
                let passes = mask((beyond >= 0) & (from[i] > 0));
                let passed = rounded_down(beyond as f32 * each).wrapping_add(1) & passes;
                t[i] = t[i].wrapping_add(passed.wrapping_mul(dt[i]));
                cell[i] = cell[i].wrapping_add(passed.wrapping_mul(step[i]));
                let since = from[i].wrapping_sub(t[i].wrapping_sub(dt[i]));
                let until = t[i].wrapping_sub(from[i]);
                let apart = mask(until >= margin) & (mask(since >= margin) | !passes);
                begins[i] &= apart | mask(from[i] == 0);
            }
        }
        let mut end = [0; RAYS];
        end.copy_from_slice(&rays.cell[first..first + RAYS]);
        // The voxel that was marked last: a ray that has ended marks it again.
        let mut marked = [last; RAYS];
        let (mut active, mut in_doubt) = ([0i32; RAYS], [0i32; RAYS]);
        for i in 0..RAYS {
            // A ray that ends where it starts passes no voxel, and one that ends before it begins is done.
            let walks = mask((frame.start_cell != end[i]) & (from[i] < ONE));
            in_doubt[i] = walks & !begins[i];
            active[i] = walks & begins[i] & mask(cell[i] != end[i]);
        }
        loop {
            let mut any = 0;
            for i in 0..RAYS {
                let (x, y, z) = (t[0][i], t[1][i], t[2][i]);
                let (lower, upper) = (x.min(y), x.max(y));
                let least = lower.min(z);
                let second = lower.max(upper.min(z));
                let certain =
                    mask(second.wrapping_sub(least) >= margin) & mask(least <= ONE - margin);
                in_doubt[i] |= active[i] & !certain;
                active[i] &= certain;
                any |= active[i];
                marked[i] = (cell[i] & active[i]) | (marked[i] & !active[i]);
                let (along_x, along_y, along_z) =
                    (mask(x == least), mask(y == least), mask(z == least));
                // Rays that have ended go on with numbers that nobody looks at.
                t[0][i] = x.wrapping_add(dt[0][i] & along_x);
                t[1][i] = y.wrapping_add(dt[1][i] & along_y);
                t[2][i] = z.wrapping_add(dt[2][i] & along_z);
                let along =
                    (step[0][i] & along_x) | (step[1][i] & along_y) | (step[2][i] & along_z);
                cell[i] = cell[i].wrapping_add(along);
                active[i] &= mask(cell[i] != end[i]);
            }
            if any == 0 {
                break;
            }
            mark(&marked);
        }
        if in_doubt != [0; RAYS] {
            let rays = (first as u32..).zip(in_doubt);
            doubtful.extend(rays.filter(|(_, d)| *d != 0).map(|(ray, _)| ray));
        }
    }
}

/// All bits set, or none.
#[inline(always)]
pub fn mask(condition: bool) -> i32 {
    -i32::from(condition)
}

/// Of a number in the range of i32, or anything that no one looks at.
#[inline(always)]
fn rounded_down(value: f32) -> i32 {
    const MOST: f32 = (1 << 30) as f32;
    let bounded = if value < MOST { value } else { MOST };
    let positive = if bounded > 0.0 { bounded } else { 0.0 };
    // SAFETY: between 0 and 2^30.
    unsafe { positive.to_int_unchecked() }
}

/// The nearest whole number in `0..=most`, `most` for NaN.
#[inline(always)]
pub fn rounded(value: f64, most: f64) -> i32 {
    let bounded = if value < most { value } else { most };
    let positive = if bounded > 0.0 { bounded } else { 0.0 };
    // SAFETY: not negative, less than `most` + 1, which is cut to an i32.
    unsafe { (positive + 0.5).to_int_unchecked() }
}

/// For machines without better: one number after the other.
#[inline(always)]
pub fn mark_each(voxels: &[i32; RAYS], window: &mut [u8]) {
    let last = window.len() - 1;
    for voxel in voxels {
        // SAFETY: within the window, which is not empty.
        unsafe { *window.get_unchecked_mut((*voxel as u32 as usize).min(last)) = FREE };
    }
}

/// About so many are marked together.
#[cfg(target_arch = "x86_64")]
pub const MOST_PENDING: usize = 1024;

/// Collects numbers that are to be marked. Neighbouring rays are often in the same voxel, so that of a run of equal numbers
/// only one is taken; how many there are is not for a branch to guess at every step.
#[cfg(target_arch = "x86_64")]
pub struct Pending<'a> {
    window: &'a mut [u8],
    numbers: [u32; MOST_PENDING + RAYS],
}

#[cfg(target_arch = "x86_64")]
impl<'a> Pending<'a> {
    /// # Panics
    /// If the window is empty.
    pub fn new(window: &'a mut [u8]) -> Self {
        assert!(!window.is_empty(), "no window");
        Self {
            window,
            numbers: [0; MOST_PENDING + RAYS],
        }
    }

    /// Take sixteen numbers in addition to `count` others (at most [`MOST_PENDING`]), and return how many are pending. The caller keeps
    /// count so that it stays in a register.
    #[inline]
    #[target_feature(enable = "avx512f,popcnt")]
    pub fn take(&mut self, voxels: &[i32; RAYS], count: usize) -> usize {
        use std::arch::x86_64::*;
        let room = &mut self.numbers[count..count + RAYS];
        let last = _mm512_set1_epi32(self.window.len() as i32 - 1);
        // SAFETY: sixteen numbers are read and written.
        unsafe {
            let all = _mm512_min_epu32(_mm512_loadu_si512(voxels.as_ptr().cast()), last);
            // No number is equal to what stands before the first.
            let before = _mm512_alignr_epi32::<15>(all, _mm512_set1_epi32(-1));
            let first = _mm512_cmpneq_epi32_mask(all, before);
            // Writing all of a register is quick everywhere, writing parts of it is not.
            let runs = _mm512_maskz_compress_epi32(first, all);
            _mm512_storeu_si512(room.as_mut_ptr().cast(), runs);
            count + first.count_ones() as usize
        }
    }

    /// Mark the pending numbers. Never inlined: where wide registers may be used, compilers take them apart again.
    #[inline(never)]
    pub fn mark(&mut self, count: usize) {
        for voxel in &self.numbers[..count] {
            // SAFETY: all numbers were cut to the window, which is not empty and stays the same.
            unsafe { *self.window.get_unchecked_mut(*voxel as usize) = FREE };
        }
    }
}
