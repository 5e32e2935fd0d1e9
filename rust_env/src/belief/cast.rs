//! Many rays through the map at once, each to its first occupied or unknown voxel: eight (AVX-512) or four (AVX2) in
//! lockstep, with the arithmetic of [`Octree::cast_ray`], operation for operation.
//!
//! The voxels that stop rays are first copied to a window of one bit each, which fits a near cache: a step is then one
//! addition to a bit's number. Around the window stands a border that stops every ray; outside nothing is known.
mod walk;

use super::lockstep::Lanes;
use super::octree::{Octree, State, KEY_LIMIT, SIDE};
use super::ray_walk::MIN_SCALE;
use crate::error::Result;
use crate::geometry::{IVec3, Vec3};
use crate::interrupt;

/// Largest window, and how much of one pays for a ray (bytes).
const MAX_WINDOW: u64 = 1 << 27;
const WINDOW_PER_RAY: u64 = 64;
/// Rays that are prepared together.
const BATCH: usize = 128;
/// Rays between two questions whether to go on.
const AT_A_TIME: usize = 1 << 15;

/// One bit a voxel, x fastest.
struct Window {
    /// Key of the voxel of bit 0.
    origin: IVec3,
    dims: IVec3,
    /// Voxels that stop a ray; three bytes more than needed, for reads of four.
    stops: Vec<u8>,
    occupied: Vec<u8>,
}

impl Window {
    /// All bricks of a map and a border of one brick; `None` if that is too much for so few rays.
    fn new(octree: &Octree, ignore_unknown: bool, rays: usize) -> Option<Self> {
        let corners = || (0..octree.bricks().len()).map(|i| octree.brick_coordinates(i));
        let low = corners().reduce(IVec3::min)? - 1;
        let high = corners().reduce(IVec3::max)? + 1;
        let bricks = high - low + 1;
        let bytes = [bricks.x, bricks.y, bricks.z, 64]
            .iter()
            .fold(1u64, |n, d| n.saturating_mul(*d as u64));
        if bytes > MAX_WINDOW.min(WINDOW_PER_RAY * rays as u64) {
            return None;
        }
        let mut window = Self {
            origin: low * SIDE,
            dims: bricks * SIDE,
            stops: vec![0xFF; bytes as usize + 3],
            occupied: vec![0; bytes as usize],
        };
        if ignore_unknown {
            for z in SIDE..window.dims.z - SIDE {
                for y in SIDE..window.dims.y - SIDE {
                    let row = window.row(SIDE, y, z);
                    window.stops[row..row + bricks.x as usize - 2].fill(0);
                }
            }
        }
        for (brick, corner) in octree.bricks().iter().zip(corners()) {
            let first = (corner - low) * SIDE;
            for z in 0..8 {
                let stops = match ignore_unknown {
                    true => brick.occupied[z],
                    false => brick.occupied[z] | !brick.known[z],
                };
                for y in 0..8 {
                    let row = window.row(first.x, first.y + y, first.z + z as i32);
                    window.stops[row] = (stops >> (8 * y)) as u8;
                    window.occupied[row] = (brick.occupied[z] >> (8 * y)) as u8;
                }
            }
        }
        Some(window)
    }

    /// Number of the byte of a voxel in the window.
    fn row(&self, x: i32, y: i32, z: i32) -> usize {
        (z as usize * self.dims.y as usize + y as usize) * (self.dims.x as usize / 8)
            + x as usize / 8
    }

    fn strides(&self) -> [i32; 3] {
        [1, self.dims.x, self.dims.x * self.dims.y]
    }
}

/// Rays ready to walk, by axis: the state of [`super::ray_walk::Dda`] with keys as bits of the window.
struct Batch {
    t: [[f64; BATCH]; 3],
    dt: [[f64; BATCH]; 3],
    step: [[i32; BATCH]; 3],
    bit: [i32; BATCH],
    /// Number of the ray.
    ray: [i32; BATCH],
    len: usize,
}

impl Batch {
    const EMPTY: Self = Self {
        t: [[0.0; BATCH]; 3],
        dt: [[0.0; BATCH]; 3],
        step: [[0; BATCH]; 3],
        bit: [0; BATCH],
        ray: [0; BATCH],
        len: 0,
    };
}

/// Rays through a window.
struct Casts<'a> {
    octree: &'a Octree,
    window: &'a Window,
    origins: &'a [Vec3],
    directions: &'a [Vec3],
    max_range: f64,
}

/// The rays that were stopped: their numbers, the bits that stopped them and where these were entered (metres).
struct Stops {
    rays: Vec<i32>,
    bits: Vec<i32>,
    entries: Vec<f32>,
    len: usize,
}

impl Stops {
    /// Elements beyond the last that may be written.
    const SPARE: usize = 8;

    /// For at most so many rays.
    fn new(rays: usize) -> Self {
        let room = rays + Self::SPARE;
        Self {
            rays: vec![0; room],
            bits: vec![0; room],
            entries: vec![0.0; room],
            len: 0,
        }
    }

    /// Where the next elements go, `count` of each list.
    #[inline(always)]
    fn room(&mut self, count: usize) -> (&mut [i32], &mut [i32], &mut [f32]) {
        let next = self.len..self.len + count;
        (
            &mut self.rays[next.clone()],
            &mut self.bits[next.clone()],
            &mut self.entries[next],
        )
    }

    #[inline(always)]
    fn push(&mut self, ray: i32, bit: i32, entry: f32) {
        let (rays, bits, entries) = self.room(1);
        (rays[0], bits[0], entries[0]) = (ray, bit, entry);
        self.len += 1;
    }

    fn iter(&self) -> impl Iterator<Item = (i32, i32, f32)> + '_ {
        let both = self.rays.iter().zip(&self.bits).zip(&self.entries);
        both.take(self.len).map(|((r, b), e)| (*r, *b, *e))
    }
}

impl Casts<'_> {
    /// Prepare `BATCH` rays from `first` on. Those that do not start in the window are put into `others`.
    #[inline(always)]
    fn prepare(&self, first: usize, batch: &mut Batch, others: &mut Vec<usize>) {
        let n = (self.origins.len() - first).min(BATCH);
        let resolution = self.octree.resolution();
        let half = f64::from((resolution * 0.5) as f32);
        let strides = self.window.strides();
        let (mut unit, mut scale) = ([[0.0f32; BATCH]; 3], [0.0f32; BATCH]);
        let mut origin = [[0.0f32; BATCH]; 3];
        for i in 0..n {
            for axis in 0..3 {
                origin[axis][i] = self.origins[first + i][axis];
                unit[axis][i] = self.directions[first + i][axis];
            }
        }
        // glam's `try_normalize`.
        let [x, y, z] = &mut unit;
        for i in 0..BATCH {
            scale[i] = 1.0 / (x[i] * x[i] + y[i] * y[i] + z[i] * z[i]).sqrt();
            x[i] *= scale[i];
            y[i] *= scale[i];
            z[i] *= scale[i];
        }
        let mut inside = [true; BATCH];
        for i in 0..BATCH {
            // Of very short and very long directions the squares lose digits.
            inside[i] = (scale[i] > MIN_SCALE) & (scale[i] < 1.0 / MIN_SCALE);
        }
        batch.bit = [0; BATCH];
        for axis in 0..3 {
            let (low, high) = (
                (self.window.origin[axis] + SIDE).max(-KEY_LIMIT),
                (self.window.origin[axis] + self.window.dims[axis] - SIDE).min(KEY_LIMIT),
            );
            for i in 0..BATCH {
                let (o, d) = (f64::from(origin[axis][i]), f64::from(unit[axis][i]));
                let key = self.octree.key_of(origin[axis][i]);
                inside[i] &= (key >= low) & (key < high) & !origin[axis][i].is_nan();
                batch.bit[i] = batch.bit[i].wrapping_add(
                    key.wrapping_sub(self.window.origin[axis])
                        .wrapping_mul(strides[axis]),
                );
                let center = (f64::from(key) + 0.5) * resolution;
                let border = center + if d > 0.0 { half } else { -half };
                let (t, dt) = ((border - o) / d, resolution / d.abs());
                let moves = d != 0.0;
                batch.t[axis][i] = if moves { t } else { f64::MAX };
                batch.dt[axis][i] = if moves { dt } else { f64::MAX };
                batch.step[axis][i] = if d > 0.0 {
                    strides[axis]
                } else {
                    -strides[axis]
                };
            }
        }
        // Close the gaps.
        let mut len = 0;
        for (i, inside) in inside.iter().enumerate().take(n) {
            if !inside {
                others.push(first + i);
                continue;
            }
            if len < i {
                for axis in 0..3 {
                    batch.t[axis][len] = batch.t[axis][i];
                    batch.dt[axis][len] = batch.dt[axis][i];
                    batch.step[axis][len] = batch.step[axis][i];
                }
                batch.bit[len] = batch.bit[i];
            }
            batch.ray[len] = (first + i) as i32;
            len += 1;
        }
        batch.len = len;
    }
}

impl Octree {
    /// [`Octree::cast_ray`] for each origin and direction (of equal number): ranges in metres, rounded to f32, and states.
    /// Fails only if it is interrupted.
    pub fn cast_rays(
        &self,
        origins: &[Vec3],
        directions: &[Vec3],
        max_range: f64,
        ignore_unknown: bool,
    ) -> Result<(Vec<f32>, Vec<State>)> {
        let lanes = Lanes::best();
        self.cast_rays_with(lanes, origins, directions, max_range, ignore_unknown)
    }

    /// The same in a given way; all ways give the same results.
    pub fn cast_rays_with(
        &self,
        lanes: Lanes,
        origins: &[Vec3],
        directions: &[Vec3],
        max_range: f64,
        ignore_unknown: bool,
    ) -> Result<(Vec<f32>, Vec<State>)> {
        let n = origins.len().min(directions.len());
        let (origins, directions) = (&origins[..n], &directions[..n]);
        let mut ranges = vec![max_range as f32; n];
        let mut states = vec![State::Free; n];
        let one = |i: usize| {
            let (range, state) =
                self.cast_ray(origins[i], directions[i], max_range, ignore_unknown);
            (range as f32, state)
        };
        let window = match lanes {
            _ if n > i32::MAX as usize => None,
            Lanes::Scalar => None,
            #[allow(unreachable_patterns)]
            _ => Window::new(self, ignore_unknown, n),
        };
        let Some(window) = window else {
            for ray in 0..n {
                interrupt::check()?;
                (ranges[ray], states[ray]) = one(ray);
            }
            return Ok((ranges, states));
        };
        let mut others = Vec::new();
        let mut stops = Stops::new(n.min(AT_A_TIME));
        for first in (0..n).step_by(AT_A_TIME) {
            interrupt::check()?;
            let some = first..n.min(first + AT_A_TIME);
            let casts = Casts {
                octree: self,
                window: &window,
                origins: &origins[some.clone()],
                directions: &directions[some],
                max_range,
            };
            stops.len = 0;
            walk::walk(lanes, &casts, &mut stops, &mut others);
            for ray in others.drain(..) {
                interrupt::check()?;
                let found = one(first + ray);
                (ranges[first + ray], states[first + ray]) = found;
            }
            for (ray, bit, entry) in stops.iter() {
                let (ray, bit) = (first + ray as usize, bit as usize);
                let occupied = window.occupied[bit / 8] >> (bit % 8) & 1 == 1;
                if occupied || !ignore_unknown {
                    ranges[ray] = entry;
                    states[ray] = if occupied {
                        State::Occupied
                    } else {
                        State::Unknown
                    };
                }
            }
        }
        Ok((ranges, states))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::belief::testing::random;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn every_way_gives_the_same_hits(
            seed in 0u64..1000,
            weights in prop::sample::select(vec![[2, 5, 1], [1, 30, 1], [8, 1, 1], [0, 60, 1]]),
            rays in prop::collection::vec(((-1.3f32..1.3, -1.3f32..1.3, -1.3f32..1.3), (-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0), 0u8..30), 1..400),
            range in 0.05f64..4.0,
            ignore_unknown in any::<bool>(),
        ) {
            let octree = random(seed, 10, weights);
            let mut origins: Vec<Vec3> = rays.iter().map(|r| Vec3::from(r.0)).collect();
            let mut directions: Vec<Vec3> = rays.iter().map(|r| Vec3::from(r.1)).collect();
            for (i, ray) in rays.iter().enumerate() {
                match ray.2 {
                    0 => directions[i] = Vec3::ZERO,
                    1 => directions[i].x = f32::NAN,
                    2 => origins[i].y = f32::INFINITY,
                    3 => origins[i].z = f32::NAN,
                    4 => origins[i] *= 1e6,
                    5 => directions[i] = Vec3::new(0.0, -0.0, -2.0),
                    6 => (origins[i], directions[i]) = (Vec3::ZERO, Vec3::new(1.0, -1.0, 1.0)),
                    _ => {}
                }
            }
            // Enough rays that a window pays.
            while origins.len() < 500 {
                origins.extend_from_within(..);
                directions.extend_from_within(..);
            }
            let reference: Vec<(u32, State)> = origins
                .iter()
                .zip(&directions)
                .map(|(o, d)| octree.cast_ray(*o, *d, range, ignore_unknown))
                .map(|(r, s)| ((r as f32).to_bits(), s))
                .collect();
            prop_assert!(Window::new(&octree, ignore_unknown, origins.len()).is_some());
            for lanes in Lanes::available() {
                let (ranges, states) = octree.cast_rays_with(lanes, &origins, &directions, range, ignore_unknown).unwrap();
                for i in 0..origins.len() {
                    prop_assert_eq!((ranges[i].to_bits(), states[i]), reference[i], "{:?} ray {}", lanes, i);
                }
            }
        }
    }

    #[test]
    fn more_rays_than_are_walked_at_a_time() {
        let octree = random(3, 10, [1, 30, 1]);
        // Some begin outside of the window.
        let at = |i: usize, k: usize| ((i * k % 997) as f32 / 997.0 - 0.5) * 2.2;
        let rays = 0..AT_A_TIME * 2 + 77;
        let origins: Vec<Vec3> = rays
            .clone()
            .map(|i| Vec3::new(at(i, 3), at(i, 7), at(i, 11)))
            .collect();
        let directions: Vec<Vec3> = rays
            .clone()
            .map(|i| Vec3::new(at(i, 13), at(i, 17), at(i, 19)))
            .collect();
        for lanes in Lanes::available() {
            let (ranges, states) = octree
                .cast_rays_with(lanes, &origins, &directions, 3.0, true)
                .unwrap();
            for i in rays.clone() {
                let (range, state) = octree.cast_ray(origins[i], directions[i], 3.0, true);
                let same = ranges[i].to_bits() == (range as f32).to_bits();
                assert!(same && states[i] == state, "{lanes:?} ray {i}");
            }
        }
    }

    #[test]
    fn an_empty_map_and_no_rays_are_fine() {
        let octree = crate::belief::testing::empty();
        let rays = vec![Vec3::X; 1000];
        let (ranges, states) = octree.cast_rays(&rays, &rays, 3.0, false).unwrap();
        assert!(ranges.iter().all(|r| *r == 0.0) && states.iter().all(|s| *s == State::Unknown));
        let (ranges, states) = octree.cast_rays(&rays, &rays, 3.0, true).unwrap();
        assert!(ranges.iter().all(|r| *r == 3.0) && states.iter().all(|s| *s == State::Free));
        assert!(octree.cast_rays(&[], &[], 3.0, true).unwrap().0.is_empty());
    }
}
