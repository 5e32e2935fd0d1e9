//! What a view promises: information gain, computed by casting the view's rays through the map.
//!
//! Two kinds of metric. A [`VoxelGain`] sums over the *distinct* voxels that a view sees; a [`RayGain`] is a fold
//! along each ray (start of ray, visit a voxel, end of ray) summed over the rays. [`ray_average`] has a third: mean
//! utilities along rays. All walk the same rays, spread by a [`RaySpacing`], voxel by voxel with the arithmetic of
//! [`super::ray_walk`], from the camera's voxel (the camera's `near` plays no part in what blocks a ray) up to the
//! last voxel entered within `max_range`.
//!
//! Exploration bounds: voxels outside count nothing; occupied ones there still end a ray. Entropies are in bits.
//! Results do not depend on the number of threads, nor on which views are asked for together.
mod entropy;
mod lockstep;
mod ray_average;
mod rays;
mod uncertainty;
mod volumetric;
mod window;

pub use rays::{directions, RaySpacing, VoxelGain};
pub use volumetric::{AREA_FACTOR_OCCLUDED, AREA_FACTOR_OCCUPIED};
pub use window::{Layers, Window, FREE, OCCUPIED, REACH, UNIT, UNKNOWN, WALL};

use super::lockstep::Lanes;
use super::octree::{KeyBox, Octree};
use super::uncertainty::UncertaintyModel;
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::geometry::{Aabb, Pose, Vec3};
use crate::interrupt::{self, Stop};
use ray_average::Utility;
use rayon::prelude::*;
use rays::{Caster, Scratch};

/// The metrics, by name in [`NAMES`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gain {
    Uncertainty,
    UnknownCount,
    Entropy,
    AverageEntropy,
    OcclusionAware,
    UnobservedVoxel,
    RearSideVoxel,
    RearSideEntropy,
    ProximityCount,
    AreaFactor,
    ViewHistory,
    RayEntropy,
    RayProbability,
}

impl Gain {
    pub const ALL: [Gain; 13] = [
        Gain::Uncertainty,
        Gain::UnknownCount,
        Gain::Entropy,
        Gain::AverageEntropy,
        Gain::OcclusionAware,
        Gain::UnobservedVoxel,
        Gain::RearSideVoxel,
        Gain::RearSideEntropy,
        Gain::ProximityCount,
        Gain::AreaFactor,
        Gain::ViewHistory,
        Gain::RayEntropy,
        Gain::RayProbability,
    ];

    pub const fn name(self) -> &'static str {
        match self {
            Gain::Uncertainty => "uncertainty",
            Gain::UnknownCount => "unknown_count",
            Gain::Entropy => "entropy",
            Gain::AverageEntropy => "average_entropy",
            Gain::OcclusionAware => "occlusion_aware",
            Gain::UnobservedVoxel => "unobserved_voxel",
            Gain::RearSideVoxel => "rear_side_voxel",
            Gain::RearSideEntropy => "rear_side_entropy",
            Gain::ProximityCount => "proximity_count",
            Gain::AreaFactor => "area_factor",
            Gain::ViewHistory => "view_history",
            Gain::RayEntropy => "ray_entropy",
            Gain::RayProbability => "ray_probability",
        }
    }

    /// The metric of a name in [`NAMES`].
    pub fn parse(name: &str) -> Result<Self> {
        Gain::ALL
            .into_iter()
            .find(|g| g.name() == name)
            .ok_or_else(|| {
                Error::invalid(format!(
                    "unknown gain {name:?}; known are {}",
                    NAMES.join(", ")
                ))
            })
    }

    /// What is averaged along rays, if the metric is of that kind.
    fn utility(self) -> Option<Utility> {
        match self {
            Gain::ViewHistory => Some(Utility::ViewHistory),
            Gain::RayEntropy => Some(Utility::Entropy),
            Gain::RayProbability => Some(Utility::Probability),
            _ => None,
        }
    }

    fn layers(self) -> Layers {
        let (entropy, probability, distance) = match self {
            Gain::Entropy | Gain::AverageEntropy => (true, false, false),
            Gain::OcclusionAware | Gain::UnobservedVoxel | Gain::RearSideEntropy => {
                (true, true, false)
            }
            Gain::ProximityCount => (false, false, true),
            Gain::Uncertainty
            | Gain::UnknownCount
            | Gain::RearSideVoxel
            | Gain::AreaFactor
            | Gain::ViewHistory
            | Gain::RayEntropy
            | Gain::RayProbability => (false, false, false),
        };
        Layers {
            entropy,
            probability,
            distance,
        }
    }
}

/// Names of the metrics, in the order of [`Gain::ALL`].
pub const NAMES: [&str; Gain::ALL.len()] = {
    let mut names = [""; Gain::ALL.len()];
    let mut i = 0;
    while i < names.len() {
        names[i] = Gain::ALL[i].name();
        i += 1;
    }
    names
};

/// A metric as a fold along a ray. One value of the type serves one view.
pub trait RayGain {
    fn begin_ray(&mut self);
    /// One voxel within the bounds, in the order along the ray; an occupied one is the ray's last.
    fn visit(&mut self, window: &Window, voxel: usize, state: u8);
    /// `hit`: the ray ended at an occupied voxel within the bounds.
    fn end_ray(&mut self, hit: bool);
    /// The view's gain, after its last ray.
    fn value(&self) -> f64;
}

/// The gain of each view (`world_from_camera`), shape (k,).
///
/// Rays go through the image as `rays` says, up to `max_range` metres, limited to the voxels that `bounds` (metres)
/// touches. Views are spread over `pool`; `None` runs them one after the other. A view outside the map's key space
/// gains 0. Errors: rays too dense or none, a max_range that is not positive and finite, rays that span more than 2^27 voxels.
#[allow(clippy::too_many_arguments)]
pub fn view_gain(
    octree: &Octree,
    views: &[Pose],
    camera: &Camera,
    gain: Gain,
    rays: impl Into<RaySpacing>,
    max_range: f32,
    bounds: Option<Aabb>,
    pool: Option<&rayon::ThreadPool>,
) -> Result<Vec<f64>> {
    view_gain_with(
        Lanes::best(),
        octree,
        views,
        camera,
        gain,
        rays,
        max_range,
        bounds,
        pool,
    )
}

/// As [`view_gain`], with the instructions that `lanes` names.
#[allow(clippy::too_many_arguments)]
fn view_gain_with(
    lanes: Lanes,
    octree: &Octree,
    views: &[Pose],
    camera: &Camera,
    gain: Gain,
    rays: impl Into<RaySpacing>,
    max_range: f32,
    bounds: Option<Aabb>,
    pool: Option<&rayon::ThreadPool>,
) -> Result<Vec<f64>> {
    let rays = rays.into();
    rays.check(camera)?;
    if gain == Gain::ViewHistory && octree.view_history().is_none() {
        return Err(Error::invalid(
            "gain \"view_history\" needs a map that keeps a view history",
        ));
    }
    if !(max_range > 0.0 && max_range.is_finite()) {
        return Err(Error::invalid(format!(
            "max_range must be a finite number of metres > 0, got {max_range}"
        )));
    }
    let (places, directions) = match gain {
        _ if gain.utility().is_some() => rays::tiled_directions(camera, rays),
        // Sums of floats depend on their order, sums over voxels do not.
        Gain::Uncertainty | Gain::UnknownCount | Gain::Entropy => {
            (Vec::new(), rays::neighbouring_directions(camera, rays))
        }
        _ => (Vec::new(), directions(camera, rays)),
    };
    let task = Task {
        octree,
        gain,
        model: UncertaintyModel::of_camera(camera),
        near: camera.near,
        directions,
        places,
        max_range,
        bounds: bounds.map(|b| KeyBox::touching(octree, &b)),
        stop: Stop::of_this_thread(),
    };
    let regions: Vec<KeyBox> = views
        .iter()
        .map(|v| task.region(v, &camera_corners(camera)))
        .collect();
    let whole = regions.iter().fold(KeyBox::EMPTY, |a, b| a.union(b));
    let separate: u64 = regions
        .iter()
        .map(KeyBox::volume)
        .fold(0, u64::saturating_add);
    if separate == 0 {
        return Ok(vec![0.0; views.len()]);
    }
    if let Some(utility) = gain.utility() {
        let none = || ();
        return each(views.len(), pool, none, |i, ()| {
            task.stop.check()?;
            if regions[i].volume() == 0 {
                return Ok(0.0);
            }
            ray_average::Scratch::of_this_thread(|scratch| {
                task.ray_average(lanes, utility, &views[i], regions[i], scratch)
            })
        });
    }
    let scratch = || Scratch::new(lanes);
    // Views that look at much the same space share one window; scattered ones unpack one each.
    // (How many there are decides how, never whether: a view gains by itself what it gains among others.)
    if whole.volume() <= separate.min(window::MAX_VOXELS) {
        let window = Window::new(octree, whole, task.bounds, gain.layers())?;
        each(views.len(), pool, scratch, |i, scratch| {
            task.gain(&window, &views[i], scratch)
        })
    } else {
        each(views.len(), pool, scratch, |i, scratch| {
            if regions[i].volume() == 0 {
                return Ok(0.0);
            }
            let window = Window::new(octree, regions[i], task.bounds, gain.layers())?;
            task.gain(&window, &views[i], scratch)
        })
    }
}

/// The gain of each view, while somebody asks whether to go on.
fn each<S>(
    count: usize,
    pool: Option<&rayon::ThreadPool>,
    scratch: impl Fn() -> S + Sync + Send,
    work: impl Fn(usize, &mut S) -> Result<f64> + Sync,
) -> Result<Vec<f64>> {
    match pool {
        Some(pool) => {
            let all = || {
                (0..count)
                    .into_par_iter()
                    .map_init(scratch, |scratch, i| work(i, scratch))
                    .collect()
            };
            interrupt::in_pool(pool, all).unwrap_or(Err(Error::Interrupted))
        }
        None => {
            let mut scratch = scratch();
            (0..count).map(|i| work(i, &mut scratch)).collect()
        }
    }
}

/// The image's corners in the camera frame, z = 1.
fn camera_corners(camera: &Camera) -> [Vec3; 4] {
    let (w, h) = (camera.width as f32, camera.height as f32);
    [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)].map(|(u, v)| {
        Vec3::new(
            (u - camera.cx) / camera.fx,
            (v - camera.cy) / camera.fy,
            1.0,
        )
    })
}

struct Task<'a> {
    octree: &'a Octree,
    gain: Gain,
    model: UncertaintyModel,
    near: f32,
    directions: Vec<Vec3>,
    /// For ray averages: the number that each ray has row by row.
    places: Vec<u32>,
    max_range: f32,
    bounds: Option<KeyBox>,
    /// Of the caller, for the threads that work for it.
    stop: Stop,
}

impl Task<'_> {
    /// The voxels that a view's rays may need: its pyramid, without what lies beyond the bounds for good.
    fn region(&self, view: &Pose, corners: &[Vec3; 4]) -> KeyBox {
        let Some(key) = self.octree.key(view.translation) else {
            return KeyBox::EMPTY;
        };
        let tips = corners.map(|c| view.point(c * self.max_range));
        let pyramid = Aabb::of(tips.into_iter().chain([view.translation]));
        // Two voxels to spare for rounding.
        let reach = if self.gain.layers().distance {
            REACH
        } else {
            0
        };
        let region = KeyBox::touching(self.octree, &pyramid).grown(2 + reach);
        // The bounds are a box: a ray that has left the box around them and the camera never comes back.
        match self.bounds {
            Some(bounds) => region.intersection(&bounds.union(&KeyBox {
                min: key,
                max: key + 1,
            })),
            None => region,
        }
    }

    fn gain(&self, window: &Window, view: &Pose, scratch: &mut Scratch) -> Result<f64> {
        self.stop.check()?;
        let Some(caster) = Caster::new(self.octree, window, view, self.max_range, &self.stop)
        else {
            return Ok(0.0);
        };
        match self.gain {
            Gain::Uncertainty => {
                let metric =
                    uncertainty::Uncertainty::new(self.octree, &self.model, view, self.near);
                caster.voxels(&self.directions, &metric, scratch)
            }
            Gain::UnknownCount => caster.voxels(&self.directions, &entropy::UnknownCount, scratch),
            Gain::Entropy => caster.voxels(&self.directions, &entropy::Entropy, scratch),
            Gain::AverageEntropy => caster.rays(
                &self.directions,
                entropy::AverageEntropy::default(),
                scratch,
            ),
            Gain::OcclusionAware => caster.rays(
                &self.directions,
                volumetric::OcclusionAware::default(),
                scratch,
            ),
            Gain::UnobservedVoxel => caster.rays(
                &self.directions,
                volumetric::UnobservedVoxel::default(),
                scratch,
            ),
            Gain::RearSideVoxel => caster.rays(
                &self.directions,
                volumetric::RearSideVoxel::default(),
                scratch,
            ),
            Gain::RearSideEntropy => caster.rays(
                &self.directions,
                volumetric::RearSideEntropy::default(),
                scratch,
            ),
            Gain::ProximityCount => caster.rays(
                &self.directions,
                volumetric::ProximityCount::default(),
                scratch,
            ),
            Gain::AreaFactor => {
                caster.rays(&self.directions, volumetric::AreaFactor::default(), scratch)
            }
            // Not cast through a window: see `ray_average`.
            Gain::ViewHistory | Gain::RayEntropy | Gain::RayProbability => Ok(0.0),
        }
    }
}

#[cfg(test)]
mod tests;
