//! Which beginnings of rays need not be walked, because other rays of the image, their *witnesses*, pass the same voxels.
//!
//! Every second pixel of every second row is a lattice, every fourth of every fourth another, and so on. A pixel of one
//! lattice that is not of the next coarser one has its witnesses there: all rays of the coarser lattice within a window
//! around it. Let a ray leave a voxel V, not its last, at the point p, z in front of the camera, and let all witnesses be
//! longer than |p| by more than a voxel's diagonal. Then one of them marks V, too:
//!
//! - V holds the ball of half a side around its centre c, and with it the ball of radius `l * side / 2` around
//!   `g = p + l (c - p)`, for any l in (0, 1].
//! - Some ray of a lattice of pitch k passes g within `k h` times g's depth, where `h = sqrt(1/fx^2 + 1/fy^2) / 2`. So one
//!   passes through that ball if `l = z kappa / (side / 2 - rho kappa)`, where `rho` is half a diagonal and `kappa` is `k h`
//!   and a little more for what rounding moves. This needs `l <= 1`: p must not be too far.
//! - On the image g is near the ray's own pixel: `f tau a / (1 - a)` pixels at most, where `a = l rho / z` and `tau` is the
//!   greatest secant of the view, whatever z is. Half a pitch further is the lattice's ray, which must be in the image.
//! - That ray is longer than its way to any point of V, so that V is not its last voxel.
//!
//! Rays shorter than a voxel are walked whole: their ends are rounded by as many metres as others', which is a larger angle.
//!
//! A witness walks V itself, or has witnesses of its own in the next lattice; the rays of the coarsest are walked whole. Tests
//! compare the maps with those of rays that are all walked whole.
use super::ends::{Ends, Sensor};
use crate::belief::curve::hilbert;
use crate::belief::lockstep::Lanes;
use crate::camera::Camera;
use crate::geometry::Vec3;

/// Pitches of the lattices.
const PITCHES: [usize; 4] = [2, 4, 8, 16];
/// Rays that reach less far, in voxels, are not worth a lattice.
const LEAST_REACH: f32 = 3.0;
/// More than half the diagonal, and more than the diagonal, of a voxel of side 1.
const HALF_DIAGONAL: f32 = 0.8661;
const DIAGONAL: f32 = 1.7325;
/// The sensor must be so far from the edges of its voxel, in voxels: near an edge voxels are left before anything is between
/// the rays.
const FROM_EDGES: f32 = 0.02;

/// Which pixels are walked whole, and where the others find their witnesses. Of one camera.
#[derive(Clone, Default)]
pub struct Witnesses {
    width: usize,
    height: usize,
    focal: [f32; 2],
    /// Half the diagonal of a pixel at distance 1, and the greatest secant.
    half_pixel: f32,
    secant: f32,
    /// Pixels (`v * width + u`) in the order in which their rays are kept: those with equal lots side by side, and of these
    /// neighbours, which are about equally long and often in the same voxel.
    pub order: Vec<u32>,
    /// For each ray, in that order, the place in [`Reaches::reach`] of its lattice cell.
    cell: Vec<u32>,
    lattices: Vec<Lattice>,
    /// Cells of all lattices, and one.
    cells: usize,
}

/// Working space for one image.
#[derive(Clone, Default)]
pub struct Reaches {
    /// Metres that rays need not be walked, by lattices and their cells; first a 0 for rays that have no witnesses.
    reach: Vec<f32>,
    along: Vec<f32>,
    /// The same in the order of rays; 0: from its beginning.
    pub skip: Vec<f32>,
}

#[derive(Clone)]
struct Lattice {
    pitch: usize,
    columns: usize,
    rows: usize,
    /// Number of each lattice ray in the order of rays.
    rays: Vec<u32>,
    /// Where its cells begin in [`Reaches::reach`].
    first: usize,
}

/// What a lattice says of voxels of one size.
struct Window {
    /// Pixels to either side, u and v.
    pixels: [usize; 2],
    /// Metres up to which there are witnesses.
    farthest: f32,
}

impl Witnesses {
    pub fn new(camera: &Camera) -> Self {
        let (width, height) = (camera.width, camera.height);
        let corner = |u: f32, v: f32| {
            let (x, y) = ((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
            (1.0 + x * x + y * y).sqrt()
        };
        let (right, bottom) = (width as f32, height as f32);
        let corners = [
            corner(0.0, 0.0),
            corner(right, 0.0),
            corner(0.0, bottom),
            corner(right, bottom),
        ];
        let mut witnesses = Self {
            width,
            height,
            focal: [camera.fx, camera.fy],
            half_pixel: 0.5 * (camera.fx.powi(-2) + camera.fy.powi(-2)).sqrt(),
            secant: corners.into_iter().fold(1.0, f32::max),
            ..Self::default()
        };
        witnesses.arrange();
        witnesses
    }

    /// The pitch of the lattice in which a pixel's witnesses are: the least that it is not itself of.
    fn pitch(u: usize, v: usize) -> Option<usize> {
        PITCHES
            .into_iter()
            .find(|k| !(u.is_multiple_of(*k) && v.is_multiple_of(*k)))
    }

    fn arrange(&mut self) {
        let (width, height) = (self.width, self.height);
        // Rays are walked side by side: those that will be walked whole come first. Near the border is for typical voxels; a
        // guess costs time, not truth.
        let near = PITCHES.map(|k| self.window(k, 1.0, 1e-4).map_or([2 * k; 2], |w| w.pixels));
        let class = |pixel: &u32| {
            let (u, v) = (*pixel as usize % width, *pixel as usize / width);
            let Some(level) = PITCHES.iter().position(|k| Some(*k) == Self::pitch(u, v)) else {
                return 0;
            };
            let [du, dv] = near[level];
            let inside = u >= du && u + du < width && v >= dv && v + dv < height;
            if inside {
                PITCHES.len() - level
            } else {
                0
            }
        };
        let curve = |pixel: &u32| hilbert(*pixel as usize % width, *pixel as usize / width);
        self.order = (0..(width * height) as u32).collect();
        self.order
            .sort_by_cached_key(|pixel| (class(pixel), curve(pixel)));
        let mut number = vec![0; self.order.len()];
        for (ray, pixel) in (0u32..).zip(&self.order) {
            number[*pixel as usize] = ray;
        }
        let mut first = 1;
        for pitch in PITCHES {
            let (columns, rows) = (width.div_ceil(pitch), height.div_ceil(pitch));
            let pixels =
                (0..rows).flat_map(|b| (0..columns).map(move |a| b * pitch * width + a * pitch));
            self.lattices.push(Lattice {
                pitch,
                columns,
                rows,
                rays: pixels.map(|pixel| number[pixel]).collect(),
                first,
            });
            first += columns * rows;
        }
        self.cells = first;
        let cell = |pixel: &u32| {
            let (u, v) = (*pixel as usize % width, *pixel as usize / width);
            let lattice =
                Self::pitch(u, v).and_then(|k| self.lattices.iter().find(|l| l.pitch == k));
            lattice.map_or(0, |l| {
                (l.first + v / l.pitch * l.columns + u / l.pitch) as u32
            })
        };
        self.cell = self.order.iter().map(cell).collect();
    }

    /// The window of a lattice for voxels of a side, in metres, if it is of any use. `rounding` is the angle by which a ray may
    /// be off.
    fn window(&self, pitch: usize, side: f32, rounding: f32) -> Option<Window> {
        let kappa = pitch as f32 * self.half_pixel + rounding;
        let a = 2.0 * HALF_DIAGONAL * kappa / (1.0 - 2.0 * HALF_DIAGONAL * kappa);
        let farthest = side * (0.5 / kappa - HALF_DIAGONAL);
        if !(0.0..0.5).contains(&a) || farthest < LEAST_REACH * side {
            return None;
        }
        let pixels = self.focal.map(|f| {
            let apart = f * self.secant * a / (1.0 - a);
            (apart + pitch as f32 / 2.0 + 0.01) as usize
        });
        Some(Window { pixels, farthest })
    }

    /// Finds how many metres from the sensor each ray, in the order, need not be walked. The rays must be those of the camera's
    /// image.
    pub fn reaches(&self, lanes: Lanes, ends: &Ends, sensor: &Sensor, found: &mut Reaches) {
        match lanes {
            Lanes::Scalar => self.find(ends, sensor, found),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Lanes` is only made where the features were detected.
            Lanes::Avx2 => unsafe { compiled::find_avx2(self, ends, sensor, found) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            Lanes::Avx512 => unsafe { compiled::find_avx512(self, ends, sensor, found) },
        }
    }

    /// One source for all kinds of lanes.
    #[inline(always)]
    fn find(&self, ends: &Ends, sensor: &Sensor, found: &mut Reaches) {
        let Reaches { reach, along, skip } = found;
        skip.clear();
        skip.resize(ends.len(), 0.0);
        let Some(rounding) = self.rounding(sensor) else {
            return;
        };
        let side = (1.0 / sensor.inverse) as f32;
        reach.clear();
        reach.resize(self.cells, 0.0);
        for lattice in &self.lattices {
            // Coarser ones see less far.
            let Some(window) = self.window(lattice.pitch, side, rounding) else {
                break;
            };
            let cells = &mut reach[lattice.first..][..lattice.columns * lattice.rows];
            self.reach_of(lattice, &window, ends, sensor, cells, along);
        }
        let [x, y, z] = &ends.position;
        let ends = x.iter().zip(y).zip(z);
        for ((skip, cell), ((x, y), z)) in skip.iter_mut().zip(&self.cell).zip(ends) {
            let long = (Vec3::new(*x, *y, *z) - sensor.origin).length_squared() > side * side;
            *skip = if long { reach[*cell as usize] } else { 0.0 };
        }
    }

    /// The angle by which rays may be off; `None` where the sensor is too near to an edge of its voxel.
    fn rounding(&self, sensor: &Sensor) -> Option<f32> {
        let mut from_faces = [0, 1, 2].map(|axis| {
            let x = sensor.inverse * f64::from(sensor.origin[axis]) - f64::from(sensor.start[axis]);
            x.min(1.0 - x) as f32
        });
        from_faces.sort_by(f32::total_cmp);
        // Points are rounded to f32: by 2^-24 of their coordinates, and a few times that of their range. Borders are rounded by
        // less than a millionth of a voxel, which is an angle of that divided by the way to the first border that counts. The
        // angle counts by depth, so that ranges count by the secant.
        let far = sensor.origin.abs().element_sum() * sensor.inverse as f32;
        let angle = (1e-5 + 2e-7 * far + 1e-6 / FROM_EDGES) * self.secant;
        (from_faces[1] >= FROM_EDGES).then_some(angle)
    }

    #[inline(always)]
    fn reach_of(
        &self,
        lattice: &Lattice,
        window: &Window,
        ends: &Ends,
        sensor: &Sensor,
        reach: &mut [f32],
        along: &mut Vec<f32>,
    ) {
        let &Lattice {
            pitch,
            columns,
            rows,
            ..
        } = lattice;
        let side = (1.0 / sensor.inverse) as f32;
        for (reach, ray) in reach.iter_mut().zip(&lattice.rays) {
            let i = *ray as usize;
            let (x, y, z) = (
                ends.position[0][i],
                ends.position[1][i],
                ends.position[2][i],
            );
            *reach = (Vec3::new(x, y, z) - sensor.origin).length() - DIAGONAL * side;
        }
        if 2 * window.pixels[0] >= self.width || 2 * window.pixels[1] >= self.height {
            // The window fits nowhere.
            reach.fill(0.0);
            return;
        }
        // A pixel of a cell looks so many cells to either side.
        let [du, dv] = window.pixels.map(|pixels| pixels.div_ceil(pitch));
        least_around(reach, columns, rows, [du, dv], along);
        let [near_u, near_v] = window.pixels;
        for (b, row) in reach.chunks_exact_mut(columns).enumerate() {
            let inside = |at: usize, near: usize, size: usize| {
                at * pitch >= near && (at + 1) * pitch + near <= size
            };
            if !inside(b, near_v, self.height) {
                row.fill(0.0);
                continue;
            }
            for (a, reach) in row.iter_mut().enumerate() {
                let far = reach.min(window.farthest);
                // A few steps are made sooner than skipped. False for NaN.
                let worth = far > 2.0 * side && inside(a, near_u, self.width);
                *reach = if worth { far } else { 0.0 };
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod compiled {
    use super::{Ends, Reaches, Sensor, Witnesses};

    #[target_feature(enable = "avx2")]
    pub fn find_avx2(of: &Witnesses, ends: &Ends, sensor: &Sensor, found: &mut Reaches) {
        of.find(ends, sensor, found);
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw")]
    pub fn find_avx512(of: &Witnesses, ends: &Ends, sensor: &Sensor, found: &mut Reaches) {
        of.find(ends, sensor, found);
    }
}

/// Replace each value of a grid by the least of those up to so many columns and rows away.
#[inline(always)]
fn least_around(
    values: &mut [f32],
    columns: usize,
    rows: usize,
    [du, dv]: [usize; 2],
    along: &mut Vec<f32>,
) {
    let least = |(o, v): (&mut f32, &f32)| *o = if *v < *o { *v } else { *o };
    along.clear();
    along.resize(columns * rows, f32::INFINITY);
    for (row, out) in values
        .chunks_exact(columns)
        .zip(along.chunks_exact_mut(columns))
    {
        for shift in 0..=du.min(columns - 1) {
            let (left, right) = (&row[..columns - shift], &row[shift..]);
            out.iter_mut().zip(right).for_each(least);
            out[shift..].iter_mut().zip(left).for_each(least);
        }
    }
    for (b, out) in values.chunks_exact_mut(columns).enumerate() {
        out.fill(f32::INFINITY);
        for row in b.saturating_sub(dv)..=(b + dv).min(rows - 1) {
            let row = &along[row * columns..][..columns];
            out.iter_mut().zip(row).for_each(least);
        }
    }
}

#[cfg(test)]
mod tests;
