//! Exact ray tracing of a whole image, sixteen rays in lockstep.
//!
//! The voxels are those of [`super::integrate`]'s walk ray by ray, which has OctoMap's arithmetic; tests compare them. Most
//! rays are walked in integers ([`fixed_point`]), which is quicker and says when it is not certain; those rays are walked
//! again in f64 ([`exact`]). Voxels are marked in a window of bytes around the sensor, x fastest: plain stores of equal
//! values cannot conflict, and a voxel's number changes by a constant per step along an axis.
//!
//! One source, compiled for each kind of [`Lanes`]: loops over sixteen rays that compilers vectorise.
mod exact;
pub(super) mod fixed_point;

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
    /// Voxels that the ray leaves within so many metres from the sensor need not be marked.
    pub skip: &'a [f32],
}

impl Rays<'_> {
    fn is_sound(&self) -> bool {
        let rays = self.cell.len();
        let lists = self.end.iter().chain([&self.skip]);
        rays.is_multiple_of(RAYS) && lists.into_iter().all(|list| list.len() == rays)
    }

    /// Unit directions, by axis, and lengths of the rays `first .. first + RAYS`, as OctoMap rounds them.
    #[inline(always)]
    fn directions(&self, frame: &Frame, first: usize) -> ([[f64; RAYS]; 3], [f32; RAYS]) {
        let (mut d, mut length) = ([[0f32; RAYS]; 3], [0f32; RAYS]);
        for (axis, d) in d.iter_mut().enumerate() {
            let end = &self.end[axis][first..first + RAYS];
            for (d, end) in d.iter_mut().zip(end) {
                *d = end - frame.origin[axis];
            }
        }
        for i in 0..RAYS {
            let squares = d[0][i] * d[0][i] + d[1][i] * d[1][i] + d[2][i] * d[2][i];
            length[i] = f64::from(squares).sqrt() as f32;
        }
        let mut unit = [[0f64; RAYS]; 3];
        for axis in 0..3 {
            for i in 0..RAYS {
                unit[axis][i] = f64::from(d[axis][i] / length[i]);
            }
        }
        (unit, length)
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
    /// No ray makes more.
    pub max_steps: i32,
}

impl Frame {
    /// Borders of the sensor's voxel as seen from it, per axis: towards minus and towards plus, minus the origin.
    #[inline(always)]
    fn borders(&self) -> [[f64; 2]; 3] {
        std::array::from_fn(|axis| {
            let center = (f64::from(self.start[axis]) + 0.5) * self.resolution;
            let half = f64::from((self.resolution * 0.5) as f32);
            let origin = f64::from(self.origin[axis]);
            [center - half - origin, center + half - origin]
        })
    }
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
                && is_x86_feature_detected!("popcnt")
            {
                return Self::Avx512;
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt") {
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

/// Rays that are walked again, kept so that nothing is allocated for them.
#[derive(Clone, Default)]
pub struct Doubtful {
    number: Vec<u32>,
    end: [Vec<f32>; 3],
    cell: Vec<i32>,
    /// Nothing: they are walked whole.
    skip: Vec<f32>,
}

impl Doubtful {
    /// Collect the rays; what fills the last block ends where it starts.
    fn take(&mut self, rays: &Rays, start_cell: i32) {
        let numbers = self.number.iter().map(|n| *n as usize);
        let padded = numbers.len().next_multiple_of(RAYS);
        for (list, end) in self.end.iter_mut().zip(rays.end) {
            list.clear();
            list.extend(numbers.clone().map(|n| end[n]));
            list.resize(padded, 0.0);
        }
        self.cell.clear();
        self.cell.extend(numbers.map(|n| rays.cell[n]));
        self.cell.resize(padded, start_cell);
        self.skip.resize(padded, 0.0);
    }

    fn rays(&self) -> Rays<'_> {
        Rays {
            end: [0, 1, 2].map(|axis| self.end[axis].as_slice()),
            cell: &self.cell,
            skip: &self.skip,
        }
    }
}

/// Mark every voxel from the sensor's up to, not including, the rays' last ones as `FREE`. The window's last byte takes what
/// must not be marked.
///
/// # Panics
/// If the window is empty or has 2^31 bytes, or the lists of rays are not as [`Rays`] says.
pub fn trace(lanes: Lanes, frame: &Frame, rays: &Rays, window: &mut [u8], doubtful: &mut Doubtful) {
    let fits = !window.is_empty() && window.len() <= i32::MAX as usize;
    assert!(
        fits && rays.is_sound(),
        "no window, or lists of rays that do not fit"
    );
    doubtful.number.clear();
    match lanes {
        Lanes::Scalar => {
            mark_each_fixed(frame, rays, window, &mut doubtful.number);
        }
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `Lanes` is only made where the features were detected.
        Lanes::Avx2 => unsafe { compiled::fixed_avx2(frame, rays, window, &mut doubtful.number) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Lanes::Avx512 => unsafe {
            compiled::fixed_avx512(frame, rays, window, &mut doubtful.number)
        },
    }
    if doubtful.number.is_empty() {
        return;
    }
    doubtful.take(rays, frame.start_cell);
    match lanes {
        Lanes::Scalar => exact::trace(frame, &doubtful.rays(), window),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Lanes::Avx2 => unsafe { compiled::exact_avx2(frame, &doubtful.rays(), window) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Lanes::Avx512 => unsafe { compiled::exact_avx512(frame, &doubtful.rays(), window) },
    }
}

/// For machines without better.
#[inline(always)]
fn mark_each_fixed(frame: &Frame, rays: &Rays, window: &mut [u8], doubtful: &mut Vec<u32>) {
    let last = window.len() as i32 - 1;
    fixed_point::trace(frame, rays, last, doubtful, |voxels| {
        fixed_point::mark_each(voxels, window)
    });
}

#[cfg(target_arch = "x86_64")]
mod compiled {
    use super::fixed_point::{self, Pending, MOST_PENDING};
    use super::{exact, mark_each_fixed, Frame, Rays};

    #[target_feature(enable = "avx2")]
    pub fn fixed_avx2(frame: &Frame, rays: &Rays, window: &mut [u8], doubtful: &mut Vec<u32>) {
        mark_each_fixed(frame, rays, window, doubtful);
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,popcnt")]
    pub fn fixed_avx512(frame: &Frame, rays: &Rays, window: &mut [u8], doubtful: &mut Vec<u32>) {
        let last = window.len() as i32 - 1;
        let mut pending = Pending::new(window);
        let mut count = 0;
        fixed_point::trace(frame, rays, last, doubtful, |voxels| {
            count = pending.take(voxels, count);
            if count > MOST_PENDING {
                pending.mark(count);
                count = 0;
            }
        });
        pending.mark(count);
    }

    #[target_feature(enable = "avx2")]
    pub fn exact_avx2(frame: &Frame, rays: &Rays, window: &mut [u8]) {
        exact::trace(frame, rays, window);
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw")]
    pub fn exact_avx512(frame: &Frame, rays: &Rays, window: &mut [u8]) {
        exact::trace(frame, rays, window);
    }
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

#[cfg(test)]
mod tests;
