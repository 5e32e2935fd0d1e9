//! The rays of a view through a window of the map.
use super::lockstep::{self, Directions, Frame, Steps, RAYS};
use super::window::{Window, OCCUPIED, UNIT, WALL};
use super::RayGain;
use crate::belief::curve::hilbert;
use crate::belief::lockstep::Lanes;
use crate::belief::octree::Octree;
use crate::belief::ray_walk::Dda;
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::geometry::{Mat3, Pose, Vec3};
use crate::interrupt::Stop;
use std::ops::Range;

/// A metric that sums over the distinct voxels a view sees.
pub trait VoxelGain {
    /// States that count and states that end a ray (such a voxel is seen, what lies behind it is not).
    const COUNTED: u8;
    const OPAQUE: u8;
    /// Gain of one seen voxel in units of 2^-31.
    fn of(&self, window: &Window, voxel: usize) -> u64;
}

/// How a view's rays are spread over its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RaySpacing {
    /// One through the centre of every block of so many pixels square (blocks at the right and lower edge may be smaller).
    Stride(usize),
    /// One every so many radians over the field of view, horizontally and vertically, whatever the image's resolution.
    AngleStep(f32),
}

impl From<usize> for RaySpacing {
    fn from(stride: usize) -> Self {
        Self::Stride(stride)
    }
}

impl RaySpacing {
    /// Most rays of a view that are spread by angle.
    const MAX_RAYS: f64 = (1 << 22) as f64;

    pub(super) fn check(self, camera: &Camera) -> Result<()> {
        match self {
            Self::Stride(0) => Err(Error::invalid("stride must be >= 1 pixel, got 0")),
            Self::Stride(_) => Ok(()),
            Self::AngleStep(step) if !(step.is_finite() && step > 0.0) => Err(Error::invalid(
                format!("angle_step must be a finite number of radians > 0, got {step}"),
            )),
            Self::AngleStep(step) => {
                // Angles of a row and of a column, at least one each.
                let count = |fov: f32| f64::from(fov / step).max(1.0);
                match count(camera.hfov()) * count(camera.vfov()) {
                    n if n <= Self::MAX_RAYS => Ok(()),
                    n => Err(Error::invalid(format!(
                        "angle_step {step:e} gives {n:.3e} rays a view, more than {}",
                        Self::MAX_RAYS
                    ))),
                }
            }
        }
    }
}

/// Unit directions in the camera's frame, row by row.
pub fn directions(camera: &Camera, rays: impl Into<RaySpacing>) -> Vec<Vec3> {
    let (us, vs) = columns_and_rows(camera, rays.into());
    let pixels = vs.iter().flat_map(|v| us.iter().map(move |u| (*u, *v)));
    pixels.map(|(u, v)| direction(camera, u, v)).collect()
}

/// The same, neighbours side by side.
pub fn neighbouring_directions(camera: &Camera, rays: RaySpacing) -> Vec<Vec3> {
    let (us, vs) = columns_and_rows(camera, rays);
    let grid = (0..vs.len()).flat_map(|b| (0..us.len()).map(move |a| (a, b)));
    let mut grid: Vec<_> = grid.collect();
    grid.sort_by_cached_key(|(a, b)| hilbert(*a, *b));
    let pixels = grid.into_iter().map(|(a, b)| (us[a], vs[b]));
    pixels.map(|(u, v)| direction(camera, u, v)).collect()
}

/// The same in tiles of 4 x 4 in tiles of 32 x 32, with the number that each ray has row by row.
pub fn tiled_directions(camera: &Camera, rays: RaySpacing) -> (Vec<u32>, Vec<Vec3>) {
    let (us, vs) = columns_and_rows(camera, rays);
    let mut grid = Vec::with_capacity(us.len() * vs.len());
    let whole = [0..us.len(), 0..vs.len()];
    tiles(whole, 32, &mut |large| {
        tiles(large, 4, &mut |[columns, rows]| {
            grid.extend(rows.flat_map(|b| columns.clone().map(move |a| (a, b))));
        });
    });
    let places = grid.iter().map(|(a, b)| (b * us.len() + a) as u32);
    let directions = grid.iter().map(|(a, b)| direction(camera, us[*a], vs[*b]));
    (places.collect(), directions.collect())
}

/// The tiles of a rectangle of columns and rows, row by row; those at the end may be smaller.
fn tiles([us, vs]: [Range<usize>; 2], side: usize, each: &mut impl FnMut([Range<usize>; 2])) {
    for v in vs.clone().step_by(side) {
        for u in us.clone().step_by(side) {
            each([u..us.end.min(u + side), v..vs.end.min(v + side)]);
        }
    }
}

fn direction(camera: &Camera, u: f32, v: f32) -> Vec3 {
    let (x, y) = ((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
    Vec3::new(x, y, 1.0).normalize()
}

/// Image coordinates of the rays.
fn columns_and_rows(camera: &Camera, rays: RaySpacing) -> (Vec<f32>, Vec<f32>) {
    match rays {
        RaySpacing::Stride(stride) => {
            let centers = |size: usize| -> Vec<f32> {
                (0..size)
                    .step_by(stride.max(1))
                    .map(|low| (low as f32 + (low.saturating_add(stride)).min(size) as f32) * 0.5)
                    .collect()
            };
            (centers(camera.width), centers(camera.height))
        }
        RaySpacing::AngleStep(step) => {
            // As many as fit, the remainder equally on both sides.
            let angles = |focal: f32, center: f32, size: usize| -> Vec<f32> {
                let (low, high) = (
                    (-center / focal).atan(),
                    ((size as f32 - center) / focal).atan(),
                );
                let count = (((high - low) / step + 1e-3) as usize).max(1);
                let first = (low + high - (count - 1) as f32 * step) * 0.5;
                (0..count)
                    .map(|i| center + focal * (first + i as f32 * step).tan())
                    .collect()
            };
            (
                angles(camera.fx, camera.cx, camera.width),
                angles(camera.fy, camera.cy, camera.height),
            )
        }
    }
}

/// A direction in the camera's frame, turned into the world's.
pub fn turned(rotation: &Mat3, d: Vec3) -> [f32; 3] {
    let m = rotation.to_cols_array_2d();
    std::array::from_fn(|a| m[0][a] * d.x + m[1][a] * d.y + m[2][a] * d.z)
}

/// Memory kept from view to view.
pub struct Scratch {
    lanes: Lanes,
    directions: Directions,
    steps: Steps,
    /// Voxels that rays met, in their order, with repetitions.
    met: Vec<u32>,
    /// Per voxel of the window the number of the last view that saw it.
    stamps: Vec<u8>,
    epoch: u8,
}

impl Scratch {
    pub fn new(lanes: Lanes) -> Self {
        Self {
            lanes,
            directions: Directions::default(),
            steps: Steps::default(),
            met: Vec::new(),
            stamps: Vec::new(),
            epoch: 0,
        }
    }

    fn stamp(&mut self, voxels: usize) -> u8 {
        if self.stamps.len() != voxels || self.epoch == u8::MAX {
            self.stamps.clear();
            self.stamps.resize(voxels, 0);
            self.epoch = 0;
        }
        self.epoch += 1;
        self.epoch
    }

    fn turn(&mut self, view: &Pose, directions: &[Vec3]) {
        let rotation = Mat3::from_quat(view.rotation);
        for (axis, turned_axis) in self.directions.axes.iter_mut().enumerate() {
            turned_axis.clear();
            turned_axis.extend(directions.iter().map(|d| turned(&rotation, *d)[axis]));
        }
    }
}

/// Casts the rays of one view.
pub struct Caster<'a> {
    window: &'a Window,
    view: &'a Pose,
    frame: Frame<'a>,
    stop: &'a Stop,
}

/// Rays between two questions whether to go on, and whose voxels are listed at a time: a multiple of the rays walked together.
const AT_A_TIME: usize = 1 << 16;

impl<'a> Caster<'a> {
    /// `None` if the camera is outside the window (which holds all cameras within the key space).
    pub fn new(
        octree: &Octree,
        window: &'a Window,
        view: &'a Pose,
        max_range: f32,
        stop: &'a Stop,
    ) -> Option<Self> {
        let start = octree.key(view.translation)?;
        window.region().contains(start).then_some(Self {
            window,
            view,
            frame: Frame {
                window,
                resolution: octree.resolution(),
                origin: view.translation,
                start,
                max_range: f64::from(max_range),
            },
            stop,
        })
    }

    /// Visit the voxels of the ray along `direction` (world frame, unit length) until `visit` returns `false`.
    #[inline(always)]
    fn walk(&self, direction: Vec3, mut visit: impl FnMut(usize, u8) -> bool) {
        let frame = &self.frame;
        let dda = Dda::new(frame.resolution, frame.start, frame.origin, direction);
        let strides = self.window.strides();
        let step: [isize; 3] = std::array::from_fn(|axis| strides[axis] * dda.step[axis] as isize);
        let [mut tx, mut ty, mut tz] = dda.t_max;
        let [dx, dy, dz] = dda.t_delta;
        let mut voxel = self.window.index(frame.start) as isize;
        loop {
            if !visit(voxel as usize, self.window.state[voxel as usize]) {
                return;
            }
            // The same comparisons as `Dda::advance`.
            let entry;
            if tx < ty && tx < tz {
                entry = tx;
                tx += dx;
                voxel += step[0];
            } else if ty < tz && ty <= tx {
                entry = ty;
                ty += dy;
                voxel += step[1];
            } else {
                entry = tz;
                tz += dz;
                voxel += step[2];
            }
            if entry > frame.max_range {
                return;
            }
        }
    }

    pub fn voxels<G: VoxelGain>(
        &self,
        directions: &[Vec3],
        metric: &G,
        scratch: &mut Scratch,
    ) -> Result<f64> {
        scratch.turn(self.view, directions);
        scratch.met.clear();
        let epoch = scratch.stamp(self.window.state.len());
        let Scratch {
            lanes,
            directions,
            met,
            stamps,
            ..
        } = scratch;
        let mut distinct = 0;
        for first in (0..directions.len()).step_by(AT_A_TIME) {
            self.stop.check()?;
            let some = first..directions.len().min(first + AT_A_TIME);
            let masks = [G::COUNTED, G::OPAQUE];
            if !lockstep::list(*lanes, &self.frame, directions, some.clone(), masks, met) {
                for ray in some {
                    self.walk(directions.get(ray), |voxel, state| {
                        if state & G::COUNTED != 0 {
                            met.push(voxel as u32);
                        }
                        state & (G::OPAQUE | WALL) == 0
                    });
                }
            }
            // Keep each once. Whether a voxel is new is hard to guess, so that no branch depends on it.
            let before = distinct;
            for i in before..met.len() {
                let voxel = met[i];
                met[distinct] = voxel;
                let stamp = &mut stamps[voxel as usize];
                distinct += usize::from(*stamp != epoch);
                *stamp = epoch;
            }
            met.truncate(distinct);
        }
        let gains = met.iter().map(|v| metric.of(self.window, *v as usize));
        Ok(gains.sum::<u64>() as f64 / UNIT)
    }

    pub fn rays<G: RayGain>(
        &self,
        directions: &[Vec3],
        mut metric: G,
        scratch: &mut Scratch,
    ) -> Result<f64> {
        scratch.turn(self.view, directions);
        let Scratch {
            lanes,
            directions,
            steps,
            ..
        } = scratch;
        for first in (0..directions.len()).step_by(RAYS) {
            if first % AT_A_TIME == 0 {
                self.stop.check()?;
            }
            let rays = (directions.len() - first).min(RAYS);
            if lockstep::steps(*lanes, &self.frame, directions, first, OCCUPIED, steps) {
                for ray in 0..rays {
                    metric.begin_ray();
                    let mut last = 0;
                    for row in steps
                        .voxels
                        .chunks_exact(RAYS)
                        .take(steps.counts[ray] as usize)
                    {
                        let voxel = row[ray] as usize;
                        last = self.window.state[voxel];
                        if last & (WALL - 1) != 0 {
                            metric.visit(self.window, voxel, last);
                        }
                    }
                    metric.end_ray(last == OCCUPIED);
                }
                continue;
            }
            for ray in first..first + rays {
                metric.begin_ray();
                let mut last = 0;
                self.walk(directions.get(ray), |voxel, state| {
                    last = state;
                    if state & (WALL - 1) != 0 {
                        metric.visit(self.window, voxel, state);
                    }
                    state & (OCCUPIED | WALL) == 0
                });
                metric.end_ray(last == OCCUPIED);
            }
        }
        Ok(metric.value())
    }
}
