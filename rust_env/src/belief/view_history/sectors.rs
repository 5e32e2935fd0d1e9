//! In which of 36 x 18 directions a sensor is seen from a point: `i = (floor(phi / delta), floor(theta / delta))` with
//! delta = pi / 18, phi the heading counter-clockwise from +x, theta the angle from straight up (Wang 2019, section III-A).
use super::{AZIMUTHS, ELEVATIONS, LAYER};
use crate::geometry::Vec3;
use std::f64::consts::PI;

/// Width of a direction, radians.
const DELTA: f64 = PI / 18.0;

/// The directions to one sensor. Borders are compared without trigonometry: which side of a line, which side of a cone.
pub struct Sectors {
    sensor: Vec3,
    /// Unit vectors at the lower borders of the azimuths.
    borders: [[f32; 2]; AZIMUTHS],
    /// Cosines of the upper borders of the elevations.
    cosines: [f32; ELEVATIONS + 1],
}

/// The directions that occur among the points of a ball; too many to say next to the sensor and right above and below it.
#[derive(Clone, Copy)]
pub struct Span {
    azimuths: Range,
    elevations: Range,
}

/// `count` neighbouring directions; azimuths go round.
#[derive(Clone, Copy)]
struct Range {
    first: usize,
    count: usize,
}

impl Sectors {
    pub fn new(sensor: Vec3) -> Self {
        Self {
            sensor,
            borders: std::array::from_fn(|k| {
                let (sin, cos) = (k as f64 * DELTA).sin_cos();
                // The axes to the bit.
                [cos, sin].map(|v| if v.abs() < 1e-9 { 0.0 } else { v as f32 })
            }),
            cosines: std::array::from_fn(|k| (k as f64 * DELTA).cos() as f32),
        }
    }

    /// Number of the direction in which the sensor is seen from `point`: `azimuth * ELEVATIONS + elevation`.
    #[inline]
    pub fn direction(&self, point: Vec3) -> usize {
        let d = self.sensor - point;
        self.azimuth(d) * ELEVATIONS + self.elevation(d)
    }

    #[inline]
    fn azimuth(&self, d: Vec3) -> usize {
        // Left of border k's line?
        let left = |k: usize| self.borders[k][0] * d.y - self.borders[k][1] * d.x >= 0.0;
        // The half plane, its quarter, and the nine borders within.
        let half = if d.y > 0.0 || (d.y == 0.0 && d.x >= 0.0) {
            0
        } else {
            18
        };
        let mut low = half + if left(half + 9) { 9 } else { 0 };
        for step in [4, 2, 1, 1] {
            if low + step < half + 18 && left(low + step) {
                low += step;
            }
        }
        low
    }

    #[inline]
    fn elevation(&self, d: Vec3) -> usize {
        let length = d.length();
        let below = |k: usize| d.z <= self.cosines[k] * length;
        let mut low = 0;
        for step in [9, 4, 2, 1, 1] {
            if low + step < ELEVATIONS && below(low + step) {
                low += step;
            }
        }
        low
    }

    /// The directions in which the sensor is seen from the points of a ball.
    pub fn span(&self, center: Vec3, radius: f32) -> Span {
        let d = self.sensor - center;
        let around = d.truncate().length();
        if around <= 2.0 * radius {
            return Span {
                azimuths: Range {
                    first: 0,
                    count: AZIMUTHS,
                },
                elevations: Range {
                    first: 0,
                    count: ELEVATIONS,
                },
            };
        }
        // Signed distance to the line of an azimuth's border, positive left of it; to the cone of an elevation's, positive
        // below it. The ball is seen under less than 60 degrees.
        let line = |k: usize| {
            let [x, y] = self.borders[k % AZIMUTHS];
            x * d.y - y * d.x
        };
        let cone = |k: usize| {
            let cos = self.cosines[k];
            around * cos - d.z * (1.0 - cos * cos).max(0.0).sqrt()
        };
        let (mut low, mut high) = (self.azimuth(d) + AZIMUTHS, self.azimuth(d) + AZIMUTHS);
        while line(low) <= radius {
            low -= 1;
        }
        while line(high + 1) >= -radius {
            high += 1;
        }
        let azimuths = Range {
            first: low % AZIMUTHS,
            count: high - low + 1,
        };
        let (mut low, mut high) = (self.elevation(d), self.elevation(d));
        while low > 0 && cone(low) <= radius {
            low -= 1;
        }
        while high + 1 < ELEVATIONS && cone(high + 1) >= -radius {
            high += 1;
        }
        let elevations = Range {
            first: low,
            count: high - low + 1,
        };
        Span {
            azimuths,
            elevations,
        }
    }

    /// The directions in which the sensor is seen from the voxels `voxels` of a layer, with the voxels of each. `corner` is
    /// the centre of the layer's first voxel, `span` that of a ball around the layer.
    pub fn split(
        &self,
        span: &Span,
        corner: Vec3,
        resolution: f32,
        voxels: u64,
        mut each: impl FnMut(usize, u64),
    ) {
        let Span {
            azimuths,
            elevations,
        } = *span;
        if azimuths.count == AZIMUTHS {
            return self.split_singly(corner, resolution, voxels, each);
        }
        let x: [f32; 8] =
            std::array::from_fn(|i| self.sensor.x - (corner.x + i as f32 * resolution));
        let y: [f32; 8] =
            std::array::from_fn(|i| self.sensor.y - (corner.y + i as f32 * resolution));
        let z = self.sensor.z - corner.z;
        let left = |k: usize| {
            let [bx, by] = self.borders[k % AZIMUTHS];
            mask(|i| bx * y[i >> 3] - by * x[i & 7] >= 0.0)
        };
        let mut lengths = [0f32; LAYER];
        if elevations.count > 1 {
            for (i, length) in lengths.iter_mut().enumerate() {
                *length = Vec3::new(x[i & 7], y[i >> 3], z).length();
            }
        }
        let below = |k: usize| mask(|i| z <= self.cosines[k] * lengths[i]);
        let mut rest = voxels;
        for a in (azimuths.first..azimuths.first + azimuths.count).rev() {
            let column = if a == azimuths.first {
                rest
            } else {
                rest & left(a)
            };
            rest &= !column;
            let mut column = column;
            for e in (elevations.first..elevations.first + elevations.count).rev() {
                if column == 0 {
                    break;
                }
                let part = if e == elevations.first {
                    column
                } else {
                    column & below(e)
                };
                column &= !part;
                if part != 0 {
                    each(a % AZIMUTHS * ELEVATIONS + e, part);
                }
            }
        }
    }

    fn split_singly(
        &self,
        corner: Vec3,
        resolution: f32,
        voxels: u64,
        mut each: impl FnMut(usize, u64),
    ) {
        let direction: [usize; LAYER] = std::array::from_fn(|i| {
            self.direction(corner + Vec3::new((i & 7) as f32, (i >> 3) as f32, 0.0) * resolution)
        });
        let mut left = voxels;
        while left != 0 {
            let now = direction[left.trailing_zeros() as usize];
            let part = left & mask(|i| direction[i] == now);
            left &= !part;
            each(now, part);
        }
    }
}

/// A bit for each voxel of a layer. A byte for each first, row by row, so that compilers work on many voxels at a time.
#[inline(always)]
pub fn mask(holds: impl Fn(usize) -> bool) -> u64 {
    let mut bits = 0;
    for row in 0..8 {
        let mut bytes = [0; 8];
        for (column, byte) in bytes.iter_mut().enumerate() {
            *byte = u8::from(holds(row * 8 + column));
        }
        // Gathers the lowest bits of eight bytes into one.
        let row_bits = u64::from_le_bytes(bytes).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        bits |= row_bits << (8 * row);
    }
    bits
}
