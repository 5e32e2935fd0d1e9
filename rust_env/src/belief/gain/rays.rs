//! The rays of a view through a window of the map.
use super::window::{Window, FREE, OCCUPIED, UNIT, WALL};
use super::RayGain;
use crate::belief::octree::Octree;
use crate::belief::ray_walk::Dda;
use crate::camera::Camera;
use crate::geometry::{IVec3, Pose, Vec3};

/// A metric that sums over the distinct voxels a view sees.
pub trait VoxelGain {
    /// States that count and states that end a ray (such a voxel is seen, what lies behind it is not).
    const COUNTED: u8;
    const OPAQUE: u8;
    /// Gain of one seen voxel in units of 2^-31.
    fn of(&self, window: &Window, voxel: usize) -> u64;
}

/// Unit directions in the camera's frame, one a block of `stride` x `stride` pixels, through the block's centre
/// (blocks at the right and lower edge may be smaller); row-major.
pub fn directions(camera: &Camera, stride: usize) -> Vec<Vec3> {
    let centers = |size: usize| {
        (0..size)
            .step_by(stride.max(1))
            .map(move |low| (low as f32 + (low.saturating_add(stride)).min(size) as f32) * 0.5)
    };
    centers(camera.height)
        .flat_map(|v| centers(camera.width).map(move |u| (u, v)))
        .map(|(u, v)| {
            Vec3::new(
                (u - camera.cx) / camera.fx,
                (v - camera.cy) / camera.fy,
                1.0,
            )
            .normalize()
        })
        .collect()
}

/// Memory kept from view to view.
#[derive(Default)]
pub struct Scratch {
    /// Per voxel of the window the number of the last view that saw it.
    stamps: Vec<u8>,
    epoch: u8,
    /// The distinct voxels seen, in the order in which rays met them.
    seen: Vec<u32>,
}

impl Scratch {
    fn begin(&mut self, voxels: usize) {
        self.seen.clear();
        if self.stamps.len() != voxels || self.epoch == u8::MAX {
            self.stamps.clear();
            self.stamps.resize(voxels, 0);
            self.epoch = 0;
        }
        self.epoch += 1;
    }
}

/// Casts the rays of one view.
pub struct Caster<'a> {
    window: &'a Window,
    resolution: f64,
    view: &'a Pose,
    key: IVec3,
    max_range: f64,
}

impl<'a> Caster<'a> {
    /// `None` if the camera is outside the window (which holds all cameras within the key space).
    pub fn new(
        octree: &Octree,
        window: &'a Window,
        view: &'a Pose,
        max_range: f32,
    ) -> Option<Self> {
        let key = octree.key(view.translation)?;
        window.region().contains(key).then_some(Self {
            window,
            resolution: octree.resolution(),
            view,
            key,
            max_range: f64::from(max_range),
        })
    }

    /// Visit the voxels of the ray along `direction` (world frame, unit length) until `visit` returns `false`.
    #[inline(always)]
    fn walk(&self, direction: Vec3, mut visit: impl FnMut(usize, u8) -> bool) {
        let dda = Dda::new(self.resolution, self.key, self.view.translation, direction);
        let strides = self.window.strides();
        let step: [isize; 3] = std::array::from_fn(|axis| strides[axis] * dda.step[axis] as isize);
        let [mut tx, mut ty, mut tz] = dda.t_max;
        let [dx, dy, dz] = dda.t_delta;
        let mut voxel = self.window.index(self.key) as isize;
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
            if entry > self.max_range {
                return;
            }
        }
    }

    pub fn voxels<G: VoxelGain>(
        &self,
        directions: &[Vec3],
        metric: &G,
        scratch: &mut Scratch,
    ) -> f64 {
        scratch.begin(self.window.state.len());
        let epoch = scratch.epoch;
        for direction in directions {
            self.walk(self.view.rotation * *direction, |voxel, state| {
                if state & G::COUNTED != 0 && scratch.stamps[voxel] != epoch {
                    scratch.stamps[voxel] = epoch;
                    scratch.seen.push(voxel as u32);
                }
                state & (G::OPAQUE | WALL) == 0
            });
        }
        let sum: u64 = scratch
            .seen
            .iter()
            .map(|v| metric.of(self.window, *v as usize))
            .sum();
        sum as f64 / UNIT
    }

    pub fn rays<G: RayGain>(&self, directions: &[Vec3], mut metric: G) -> f64 {
        for direction in directions {
            metric.begin_ray();
            let mut hit = false;
            self.walk(self.view.rotation * *direction, |voxel, state| {
                if state & (WALL - 1) != 0 {
                    metric.visit(self.window, voxel, state);
                }
                hit = state == OCCUPIED;
                state & (OCCUPIED | WALL) == 0
            });
            metric.end_ray(hit);
        }
        metric.value()
    }
}

const _: () = assert!(FREE < WALL);
