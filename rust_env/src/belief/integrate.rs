//! Putting an image into the map: OctoMap's `insertPointCloud`, voxel for voxel and bit for bit.
//!
//! Exact integration (the default): every pixel's ray is walked, each voxel is updated once per image, and hits
//! beat misses. The rays of an image first mark voxels in a frame around them (no map access, no allocation once
//! warm), then every touched brick is updated once. Rays are walked in lockstep ([`super::lockstep`]), one by one for images
//! that span very much space.
mod ends;
mod frame;
mod optics;
mod project;
mod witnesses;

use super::lockstep::{Lanes, MAX_WINDOW};
use super::octree::{BrickUpdate, Octree, KEY_LIMIT, SIDE, VOXELS};
use super::uncertainty::UncertaintyModel;
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::geometry::{IVec3, Pose, Vec3};
use ends::{Ends, Seen, Sensor};
use frame::Frame;
pub use optics::Optics;
use project::Projection;
use std::cell::RefCell;
use std::sync::Arc;
use witnesses::Reaches;

/// Most bricks that one image may change (two gigabytes, were they all new).
const MAX_BRICKS: usize = 1 << 20;

/// How an image gets into the map, by name in [`Integration::NAMES`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Integration {
    /// Every ray, voxel by voxel.
    #[default]
    Exact,
    /// One ray for all points in a voxel, to its centre: OctoMap's `discretize`.
    Discretized,
    /// No rays: the centre of each voxel is compared with the depth image. Only for depth images.
    Projective,
}

impl Integration {
    pub const ALL: [Self; 3] = [Self::Exact, Self::Discretized, Self::Projective];
    pub const NAMES: [&'static str; 3] = [
        Self::ALL[0].name(),
        Self::ALL[1].name(),
        Self::ALL[2].name(),
    ];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Discretized => "discretized",
            Self::Projective => "projective",
        }
    }

    pub fn parse(name: &str) -> Result<Self> {
        Self::ALL
            .into_iter()
            .find(|i| i.name() == name)
            .ok_or_else(|| {
                Error::invalid(format!(
                    "integration must be one of {}, got {name:?}",
                    Self::NAMES.join(", ")
                ))
            })
    }
}

/// The memory of an integration, kept from image to image.
#[derive(Clone)]
pub struct Integrator {
    lanes: Lanes,
    /// Images that span more voxels are walked ray by ray.
    max_window: u64,
    integration: Integration,
    /// Of the last image's camera.
    optics: Option<Arc<Optics>>,
    ends: Ends,
    reaches: Reaches,
    seen: Seen,
    frame: Frame,
    projection: Projection,
    /// Cell of the frame, its free voxels, its frame brick.
    updates: Vec<(IVec3, [u64; 8], Option<u32>)>,
}

impl Default for Integrator {
    fn default() -> Self {
        Self::with_lanes(Lanes::best())
    }
}

impl Integrator {
    /// An integrator that works in a given way; all ways give the same map.
    pub fn with_lanes(lanes: Lanes) -> Self {
        Self {
            lanes,
            max_window: MAX_WINDOW,
            integration: Integration::Exact,
            optics: None,
            ends: Ends::default(),
            reaches: Reaches::default(),
            seen: Seen::default(),
            frame: Frame::default(),
            projection: Projection::default(),
            updates: Vec::new(),
        }
    }

    /// Work with the integrator of this thread, whose memory all maps share that are filled one after the other.
    pub fn of_this_thread<T>(work: impl FnOnce(&mut Self) -> T) -> T {
        thread_local! {
            static INTEGRATOR: RefCell<Integrator> = RefCell::default();
        }
        INTEGRATOR.with_borrow_mut(|integrator| {
            let done = work(integrator);
            integrator.frame.give_back();
            done
        })
    }

    /// From now on, images are put in like this.
    pub fn using(&mut self, integration: Integration) -> &mut Self {
        self.integration = integration;
        self
    }

    /// Insert a depth image (row-major, `camera.width * camera.height` values) taken from `world_from_camera`.
    /// NaN, negative and zero depths are no measurement; +inf is a ray that met nothing within `max_range`
    /// (default: the camera's `far`), which frees space up to there. `max_range` is a range along the ray.
    pub fn insert_depth(
        &mut self,
        octree: &mut Octree,
        depth: &[f32],
        camera: &Camera,
        world_from_camera: &Pose,
        max_range: Option<f64>,
        model: &UncertaintyModel,
    ) -> Result<()> {
        if depth.len() != camera.pixels() {
            return Err(Error::invalid(format!(
                "depth has {} values, the camera {} x {} pixels",
                depth.len(),
                camera.height,
                camera.width
            )));
        }
        let max_range = max_range.unwrap_or(f64::from(camera.far));
        let sensor = sensor(octree, world_from_camera.translation, max_range)?;
        let optics = match self.optics.take() {
            Some(held) if held.is_of(camera, model) => held,
            _ => Optics::of(camera, model),
        };
        let optics = self.optics.insert(optics);
        self.ends.of_depth(
            self.lanes,
            depth,
            camera,
            optics,
            world_from_camera,
            &sensor,
        );
        if self.integration == Integration::Discretized {
            self.ends.discretize(octree, &mut self.seen);
        }
        self.ends.find(self.lanes, &sensor);
        self.reaches.skip.clear();
        if self.integration == Integration::Exact {
            optics
                .witnesses
                .reaches(self.lanes, &self.ends, &sensor, &mut self.reaches);
        }
        if self.integration != Integration::Projective {
            return self.walk(octree, &sensor);
        }
        self.projection.prepare(depth, camera, max_range);
        self.frame.lay(self.ends.low, self.ends.high)?;
        self.projection.trace(
            &mut self.frame,
            camera,
            world_from_camera,
            octree.resolution(),
        );
        self.frame.hits(self.lanes, &self.ends);
        self.apply(octree)
    }

    /// Insert points (world frame) seen from `origin`. Points beyond `max_range` free space up to there;
    /// without a camera the uncertainty is that of the distance alone (Lluvia 2023, Eq. 2).
    pub fn insert_points(
        &mut self,
        octree: &mut Octree,
        points: impl IntoIterator<Item = Vec3>,
        origin: Vec3,
        max_range: Option<f64>,
    ) -> Result<()> {
        if let Some(r) = max_range {
            crate::error::positive("max_range", r)?;
        }
        if self.integration == Integration::Projective {
            return Err(Error::invalid(
                "integration \"projective\" needs a depth image, not points",
            ));
        }
        let sensor = sensor(octree, origin, max_range.unwrap_or(f64::INFINITY))?;
        self.ends.of_points(points, origin);
        if self.integration == Integration::Discretized {
            self.ends.discretize(octree, &mut self.seen);
        }
        self.ends.find(self.lanes, &sensor);
        self.reaches.skip.clear();
        self.walk(octree, &sensor)
    }

    fn walk(&mut self, octree: &mut Octree, sensor: &Sensor) -> Result<()> {
        let cells = self.frame.lay(self.ends.low, self.ends.high)?;
        if cells * VOXELS as u64 >= self.max_window {
            self.frame.trace(octree.resolution(), sensor, &self.ends);
        } else {
            self.frame.trace_in_lockstep(
                self.lanes,
                octree.resolution(),
                sensor,
                &self.ends,
                &mut self.reaches.skip,
            );
        }
        self.frame.hits(self.lanes, &self.ends);
        self.apply(octree)
    }

    /// In the order of the frame's cells, so that the map does not depend on the order of the rays.
    fn apply(&mut self, octree: &mut Octree) -> Result<()> {
        let frame = &self.frame;
        let (mut low, mut high) = (IVec3::ZERO, frame.dims - 1);
        if let Some(limits) = octree.limits() {
            low = low.max((limits.min >> 3) - frame.origin);
            high = high.min(((limits.max - 1) >> 3) - frame.origin);
        }
        self.updates.clear();
        let (mut reserve_low, mut reserve_high) = (IVec3::MAX, IVec3::MIN);
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                for x in low.x..=high.x {
                    let c = IVec3::new(x, y, z);
                    let (free, slot) = frame.seen(self.lanes, c);
                    if slot.is_some() || free != [0; 8] {
                        reserve_low = reserve_low.min(c);
                        reserve_high = reserve_high.max(c);
                        self.updates.push((c, free, slot));
                    }
                }
            }
        }
        if self.updates.len() > MAX_BRICKS {
            return Err(Error::invalid(format!(
                "what the sensor sees is spread over {} bricks of {} m, more than {MAX_BRICKS}: use a max_range or a coarser resolution",
                self.updates.len(),
                octree.resolution() * f64::from(SIDE)
            )));
        }
        if !self.updates.is_empty() {
            octree.reserve(frame.origin + reserve_low, frame.origin + reserve_high)?;
        }
        for (c, free, slot) in &self.updates {
            let (hit, uncertainty) = slot.map_or(([0; 8], None), |s| frame.hit(s));
            octree.apply(&BrickUpdate {
                brick: frame.origin + *c,
                free: *free,
                hit,
                uncertainty,
            });
        }
        Ok(())
    }
}

fn sensor(octree: &Octree, origin: Vec3, max_range: f64) -> Result<Sensor> {
    match octree.key(origin) {
        Some(start) => Ok(Sensor {
            origin,
            start,
            max_range,
            inverse: octree.inverse(),
        }),
        None => Err(Error::invalid(format!(
            "the sensor's position {origin} is not finite or outside the map's key space of +-{} m",
            octree.resolution() * f64::from(KEY_LIMIT)
        ))),
    }
}

/// OctoMap's `Vector3::norm`: the sum of squares in f32, the root in f64.
#[inline]
fn norm(v: Vec3) -> f64 {
    f64::from(v.x * v.x + v.y * v.y + v.z * v.z).sqrt()
}

#[cfg(test)]
mod tests;
