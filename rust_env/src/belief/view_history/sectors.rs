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
struct Span {
    azimuths: Range,
    elevations: Range,
}

/// `count` neighbouring directions; azimuths go round.
#[derive(Clone, Copy)]
struct Range {
    first: usize,
    count: usize,
}

/// The directions of a brick's voxels as far as its layers share them: azimuths do not depend on the height.
pub struct Column {
    /// Each azimuth's first direction, with the voxels (of any layer) from which the sensor is seen there.
    azimuths: [(usize, u64); AZIMUTHS],
    count: usize,
    elevations: Range,
    /// Squared horizontal distances to the sensor.
    squares: [f32; LAYER],
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
    fn span(&self, center: Vec3, radius: f32) -> Span {
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

    /// What [`Self::split`] needs to know of a brick. `corner` is the centre of its first voxel, `radius` that of a ball around
    /// the brick.
    #[inline(always)]
    pub fn column(&self, corner: Vec3, resolution: f32, radius: f32) -> Column {
        let Span {
            azimuths,
            elevations,
        } = self.span(corner + 3.5 * resolution, radius);
        let x: [f32; 8] =
            std::array::from_fn(|i| self.sensor.x - (corner.x + i as f32 * resolution));
        let y: [f32; 8] =
            std::array::from_fn(|i| self.sensor.y - (corner.y + i as f32 * resolution));
        let mut squares = [0.0; LAYER];
        for (i, square) in squares.iter_mut().enumerate() {
            *square = x[i & 7] * x[i & 7] + y[i >> 3] * y[i >> 3];
        }
        let mut column = Column {
            azimuths: [(0, 0); AZIMUTHS],
            count: 0,
            elevations,
            squares,
        };
        let mut rest = u64::MAX;
        let mut add = |azimuth: usize, part: u64| {
            if part != 0 {
                column.azimuths[column.count] = (azimuth * ELEVATIONS, part);
                column.count += 1;
            }
        };
        if azimuths.count == AZIMUTHS {
            let azimuth: [usize; LAYER] =
                std::array::from_fn(|i| self.azimuth(Vec3::new(x[i & 7], y[i >> 3], 0.0)));
            while rest != 0 {
                let now = azimuth[rest.trailing_zeros() as usize];
                let part = mask(|i| azimuth[i] == now);
                rest &= !part;
                add(now, part);
            }
            return column;
        }
        for a in (azimuths.first + 1..azimuths.first + azimuths.count).rev() {
            let [bx, by] = self.borders[a % AZIMUTHS];
            let part = rest & mask(|i| bx * y[i >> 3] - by * x[i & 7] >= 0.0);
            rest &= !part;
            add(a % AZIMUTHS, part);
        }
        add(azimuths.first, rest);
        column
    }

    /// The directions in which the sensor is seen from the voxels `voxels` of a layer. `height` is the z of the layer's centres,
    /// `column` the brick's.
    #[inline(always)]
    pub fn split<'a>(&self, column: &'a Column, height: f32, voxels: u64) -> Parts<'a> {
        let Range { first, count } = column.elevations;
        let mut parts = Parts {
            azimuths: &column.azimuths[..column.count],
            elevations: [(first, voxels); ELEVATIONS],
            count: 1,
        };
        if count == 1 {
            return parts;
        }
        let z = self.sensor.z - height;
        let mut lengths = column.squares;
        for length in &mut lengths {
            *length = (*length + z * z).sqrt();
        }
        parts.count = 0;
        let mut rest = voxels;
        for e in (first..first + count).rev() {
            let part = if e == first {
                rest
            } else {
                rest & mask(|i| z <= self.cosines[e] * lengths[i])
            };
            rest &= !part;
            if part != 0 {
                parts.elevations[parts.count] = (e, part);
                parts.count += 1;
            }
        }
        parts
    }
}

/// The voxels of a layer by direction.
pub struct Parts<'a> {
    azimuths: &'a [(usize, u64)],
    elevations: [(usize, u64); ELEVATIONS],
    count: usize,
}

impl Parts<'_> {
    /// Directions, each with its voxels.
    #[inline(always)]
    pub fn iter(&self) -> impl Iterator<Item = (usize, u64)> + '_ {
        let elevations = &self.elevations[..self.count];
        let all = self.azimuths.iter().flat_map(move |(azimuth, column)| {
            let parts = elevations.iter();
            parts.map(move |(elevation, layer)| (azimuth + elevation, column & layer))
        });
        all.filter(|(_, part)| *part != 0)
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
