//! Walking a view's rays through a field of utilities: sixteen in lockstep, or one by one.
//!
//! Rays one by one have the arithmetic of [`Dda`], in f64. Rays in lockstep are walked in 32-bit fixed point, as images are
//! (`belief::lockstep::fixed_point`): which voxel comes next is certain if the two nearest borders are further apart than rounding
//! can have moved them. A ray that is in doubt is walked again by itself, so that all ways give the same bits.
// Other processors walk rays one by one.
#![cfg_attr(not(target_arch = "x86_64"), allow(dead_code))]

use super::field::{decoded, Field, UNEXPLORED, UNFILLED, WALL};
use crate::belief::lockstep::fixed_point::{margin, mask, rounded, ONE};
use crate::belief::lockstep::Lanes;
use crate::belief::ray_walk::Dda;
use crate::error::Result;
use crate::geometry::{IVec3, Mat3, Vec3};
use crate::interrupt::Stop;

/// Rays walked together.
const RAYS: usize = 16;
/// Rays between two questions whether to go on.
const AT_A_TIME: usize = 1 << 16;

/// Unit directions in the world, by axis; as many as there are rays, and zeros up to a multiple of [`RAYS`].
#[derive(Default)]
pub struct Rays {
    axes: [Vec<f32>; 3],
    count: usize,
    /// What each ray is worth.
    utilities: Vec<f32>,
}

impl Rays {
    pub fn turn(&mut self, rotation: &Mat3, directions: &[Vec3]) {
        self.count = directions.len();
        for out in &mut self.axes {
            out.clear();
            out.resize(self.count.next_multiple_of(RAYS), 0.0);
        }
        self.utilities.resize(self.count, 0.0);
        let [x, y, z] = &mut self.axes;
        let out = x.iter_mut().zip(y).zip(z);
        for (((x, y), z), d) in out.zip(directions) {
            [*x, *y, *z] = super::super::rays::turned(rotation, *d);
        }
    }

    fn get(&self, ray: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|axis| self.axes[axis][ray]))
    }
}

/// What all rays of a view share.
pub struct Walk {
    /// Changes of a voxel's number per step, see [`Field::strides`].
    pub strides: [[i32; 2]; 3],
    /// Number of the camera's voxel.
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
    /// The mean utility of the rays. `places` says where in the sum each stands, since sums of floats depend on their order. `fill`
    /// fills the brick of a voxel's number.
    pub fn mean(
        &self,
        lanes: Lanes,
        rays: &mut Rays,
        places: &[u32],
        field: &mut Field,
        fill: impl Fn(&mut Field, usize),
        stop: &Stop,
    ) -> Result<f64> {
        if rays.count == 0 {
            return Ok(0.0);
        }
        for first in (0..rays.count).step_by(RAYS) {
            if first % AT_A_TIME == 0 {
                stop.check()?;
            }
            let (utilities, doubtful) = match lanes {
                Lanes::Scalar => ([0.0; RAYS], u32::MAX),
                #[cfg(target_arch = "x86_64")]
                // SAFETY: `lanes` says that the machine has these instructions.
                Lanes::Avx2 => unsafe { compiled::avx2(self, rays, first, field, &fill) },
                #[cfg(target_arch = "x86_64")]
                // SAFETY: as above.
                Lanes::Avx512 => unsafe { compiled::avx512(self, rays, first, field, &fill) },
            };
            let places = &places[first..rays.count.min(first + RAYS)];
            for (i, (place, utility)) in places.iter().zip(utilities).enumerate() {
                rays.utilities[*place as usize] = if doubtful >> i & 1 == 1 {
                    self.one(rays.get(first + i), field, &fill)
                } else {
                    utility
                };
            }
        }
        let sum: f64 = rays.utilities.iter().map(|u| f64::from(*u)).sum();
        Ok(sum / rays.count as f64)
    }

    fn one(&self, direction: Vec3, field: &mut Field, fill: &impl Fn(&mut Field, usize)) -> f32 {
        let mut dda = Dda::new(self.resolution, self.key, self.origin, direction);
        let (mut sum, mut count) = (0f32, 0u32);
        let mut entry = 0.0;
        for _ in 0..self.steps {
            let number = field.number(dda.key);
            let there = |field: &Field| field.values.get(number).copied();
            let mut value = there(field);
            if value == Some(UNFILLED) {
                fill(field, number);
                value = there(field);
            }
            let value = value.map_or(WALL, decoded);
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
            entry = dda.advance();
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

    /// Where rays `first .. first + RAYS` begin. One source for all instruction sets.
    #[inline(always)]
    fn begin(&self, rays: &Rays, first: usize) -> Begin {
        let units = f64::from(ONE) / self.max_range;
        let mut begin = Begin {
            t: [[0; RAYS]; 3],
            dt: [[0; RAYS]; 3],
            minus: [[0; RAYS]; 3],
            outside: [0; RAYS],
            near: rounded(self.near * units, f64::from(ONE)),
        };
        for axis in 0..3 {
            // As in `Dda::new`.
            let center = (f64::from(self.key[axis]) + 0.5) * self.resolution;
            let half = f64::from((self.resolution * 0.5) as f32);
            let origin = f64::from(self.origin[axis]);
            let (minus_border, plus_border) = (center - half - origin, center + half - origin);
            let directions = &rays.axes[axis][first..first + RAYS];
            for (i, d) in directions.iter().enumerate() {
                let d = f64::from(*d);
                let plus = d > 0.0;
                let border = if plus { plus_border } else { minus_border };
                let each = units / d;
                // No border is met along an axis on which the ray does not move.
                let t0 = if plus | (d < 0.0) {
                    border * each
                } else {
                    f64::INFINITY
                };
                begin.t[axis][i] = rounded(t0, f64::from(i32::MAX));
                begin.dt[axis][i] = rounded((self.resolution * each).abs(), f64::from(ONE - 1));
                begin.minus[axis][i] = mask(!plus);
                begin.outside[i] |= mask(t0 < 0.0);
            }
        }
        begin
    }

    /// The utilities of rays `first .. first + RAYS`, and a bit for each that is in doubt. `look` reads the values of sixteen
    /// voxels, whose numbers are within the field.
    #[inline(always)]
    fn together(
        &self,
        rays: &Rays,
        first: usize,
        field: &mut Field,
        fill: &impl Fn(&mut Field, usize),
        look: impl Fn(&[u32], &[i32; RAYS]) -> [u32; RAYS],
    ) -> ([f32; RAYS], u32) {
        let Begin {
            mut t,
            dt,
            minus,
            outside,
            near,
        } = self.begin(rays, first);
        let last = field.values.len() as i32 - 1;
        let (within, beyond) = (self.strides.map(|s| s[0]), self.strides.map(|s| s[1]));
        let mut cell = [self.start; RAYS];
        let (mut active, mut in_doubt, mut new) = ([0i32; RAYS], [0i32; RAYS], [0i32; RAYS]);
        for i in 0..RAYS {
            let ray = mask(first + i < rays.count);
            in_doubt[i] = ray & outside[i];
            active[i] = ray & !outside[i];
        }
        // Is the voxel entered beyond the nearest range?
        let mut counts = [mask(0.0 >= self.near); RAYS];
        let (mut sum, mut count) = ([0f32; RAYS], [0i32; RAYS]);
        for passed in 0..self.steps as i32 {
            let margin = margin(passed + 1);
            for cell in &mut cell {
                // No ray leaves the field; should one, it reads what is there.
                *cell = (*cell as u32).min(last as u32) as i32;
            }
            let mut value = look(&field.values, &cell);
            let mut missing = 0;
            for i in 0..RAYS {
                missing |= active[i] & mask(value[i] == UNFILLED);
            }
            if missing != 0 {
                for i in 0..RAYS {
                    let number = cell[i] as usize;
                    if active[i] != 0 && field.values[number] == UNFILLED {
                        fill(field, number);
                    }
                }
                value = look(&field.values, &cell);
            }
            let mut any = 0;
            for i in 0..RAYS {
                let value = decoded(value[i]);
                let counted = active[i] & counts[i];
                let open = counted & mask(value == UNEXPLORED);
                new[i] |= open;
                let utility = value.abs();
                let counted = counted & mask(utility <= 1.0);
                sum[i] += f32::from_bits(utility.to_bits() & counted as u32);
                count[i] -= counted;
                active[i] &= !(open | (value.to_bits() as i32 >> 31));
                let (x, y, z) = (t[0][i], t[1][i], t[2][i]);
                let (lower, upper) = (x.min(y), x.max(y));
                let least = lower.min(z);
                let second = lower.max(upper.min(z));
                let certain = mask(second.wrapping_sub(least) >= margin)
                    & mask(least.wrapping_sub(near).wrapping_abs() >= margin)
                    & mask(least.wrapping_sub(ONE).wrapping_abs() >= margin);
                in_doubt[i] |= active[i] & !certain;
                active[i] &= certain & mask(least <= ONE);
                counts[i] = mask(least >= near);
                any |= active[i];
                let (along_x, along_y, along_z) =
                    (mask(x == least), mask(y == least), mask(z == least));
                t[0][i] = x.wrapping_add(dt[0][i] & along_x);
                t[1][i] = y.wrapping_add(dt[1][i] & along_y);
                t[2][i] = z.wrapping_add(dt[2][i] & along_z);
                let choose =
                    |of: [i32; 3]| (of[0] & along_x) | (of[1] & along_y) | (of[2] & along_z);
                let minus = choose([minus[0][i], minus[1][i], minus[2][i]]);
                // The last voxel of its brick in this direction: its bits are all set, or none.
                let bits = choose(WITHIN);
                let leaps = mask((cell[i] ^ minus) & bits == bits);
                let stride = (choose(within) & !leaps) | (choose(beyond) & leaps);
                // Rays that have ended stay where they are: memory elsewhere would be read for nothing.
                let moved = (stride ^ minus).wrapping_sub(minus) & active[i];
                cell[i] = cell[i].wrapping_add(moved);
            }
            if any == 0 {
                break;
            }
        }
        let mut utilities = [0f32; RAYS];
        let mut doubtful = 0;
        for i in 0..RAYS {
            let mean = if count[i] == 0 {
                0.0
            } else {
                sum[i] / count[i] as f32
            };
            utilities[i] = if new[i] != 0 { 1.0 } else { mean };
            doubtful |= (in_doubt[i] as u32 & 1) << i;
        }
        (utilities, doubtful)
    }
}

/// Sixteen rays at their beginning, in fixed point: the longest range is [`ONE`].
struct Begin {
    /// Distances to the next border, and from border to border, by axis.
    t: [[i32; RAYS]; 3],
    dt: [[i32; RAYS]; 3],
    /// All bits set where the ray goes towards minus.
    minus: [[i32; RAYS]; 3],
    /// All bits set where the camera lies a rounding beyond its voxel's border: `t` cannot say how far.
    outside: [i32; RAYS],
    near: i32,
}

/// Bits of a voxel's number that say where in its brick it is, by axis.
const WITHIN: [i32; 3] = [7, 7 << 3, 7 << 6];

#[cfg(target_arch = "x86_64")]
mod compiled {
    use super::{Field, Rays, Walk, RAYS};
    use std::arch::x86_64::*;

    /// SAFETY: needs the instructions.
    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,popcnt")]
    pub fn avx512(
        walk: &Walk,
        rays: &Rays,
        first: usize,
        field: &mut Field,
        fill: &impl Fn(&mut Field, usize),
    ) -> ([f32; RAYS], u32) {
        walk.together(rays, first, field, fill, |values, cells| {
            let mut out = [0; RAYS];
            // SAFETY: sixteen numbers, each within the field.
            unsafe {
                let at = _mm512_loadu_si512(cells.as_ptr().cast());
                let found = _mm512_i32gather_epi32::<4>(at, values.as_ptr().cast());
                _mm512_storeu_si512(out.as_mut_ptr().cast(), found);
            }
            out
        })
    }

    /// SAFETY: needs the instructions.
    #[target_feature(enable = "avx2,popcnt")]
    pub fn avx2(
        walk: &Walk,
        rays: &Rays,
        first: usize,
        field: &mut Field,
        fill: &impl Fn(&mut Field, usize),
    ) -> ([f32; RAYS], u32) {
        walk.together(rays, first, field, fill, |values, cells| {
            let mut out = [0; RAYS];
            for half in [0, 8] {
                // SAFETY: as above, eight numbers.
                unsafe {
                    let at = _mm256_loadu_si256(cells.as_ptr().add(half).cast());
                    let found = _mm256_i32gather_epi32::<4>(values.as_ptr().cast(), at);
                    _mm256_storeu_si256(out.as_mut_ptr().add(half).cast(), found);
                }
            }
            out
        })
    }
}
