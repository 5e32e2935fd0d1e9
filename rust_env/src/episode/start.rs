//! Where an episode begins.
use crate::belief::viewpoints::ViewSpace;
use crate::belief::Prior;
use crate::error::{Error, Result};
use crate::geometry::{Pose, Vec3};
use crate::setup::Setup;
use crate::world::SceneAssets;
use rand::seq::IndexedRandom;
use rand_pcg::Pcg64Mcg;

#[derive(Clone, Copy)]
pub struct Start {
    pub pose: Pose,
    /// Centre of the fixed views, if the task has such.
    pub anchor: Vec3,
}

impl Start {
    pub fn prior(&self, assets: &SceneAssets) -> Prior {
        Prior {
            bounds: assets.scene.bounds,
            start: self.pose,
            anchor: self.anchor,
        }
    }

    /// Whether `draw` can have given this anchor.
    pub fn is_of(&self, assets: &SceneAssets) -> bool {
        let is = |p: Vec3| p == self.anchor;
        is(assets.scene.bounds.center()) || assets.starts.iter().any(|(p, _)| is(*p))
    }

    pub fn draw(setup: &Setup, assets: &SceneAssets, rng: &mut Pcg64Mcg) -> Result<Self> {
        let scene = &assets.scene;
        let radius = setup.robot.radius();
        let none = |what: &str| {
            Err(Error::invalid(format!(
                "scene {:?} has no {what} for a body of radius {radius} m",
                scene.name
            )))
        };
        let anchors = match &setup.views {
            ViewSpace::SixDirections { .. } => {
                let free: Vec<_> = assets
                    .starts
                    .iter()
                    .filter(|(p, _)| assets.shape.is_free(*p, radius))
                    .collect();
                let Some((position, yaw)) = free.choose(rng) else {
                    return none("free start");
                };
                return Ok(Self {
                    pose: Pose::from_yaw_pitch(*position, *yaw, 0.0),
                    anchor: *position,
                });
            }
            // The roomiest place where the robot has room.
            ViewSpace::Dome { .. } => assets.starts.iter().map(|(p, _)| *p).collect(),
            ViewSpace::Ring { .. } => vec![scene.bounds.center()],
        };
        for &anchor in &anchors {
            if let Some(pose) = free_views(setup, assets, anchor).choose(rng) {
                return Ok(Self {
                    pose: *pose,
                    anchor,
                });
            }
        }
        none(if anchors.is_empty() {
            "place for a dome"
        } else {
            "free viewpoint"
        })
    }
}

/// The fixed views around `anchor` where the robot has room: its body and, with its shoulder at the anchor, its arm.
pub fn free_views(setup: &Setup, assets: &SceneAssets, anchor: Vec3) -> Vec<Pose> {
    let mut views = setup.views.views(&Pose::IDENTITY, anchor);
    let (shape, radius) = (&assets.shape, setup.robot.radius());
    views.retain(|v| match setup.robot.arm() {
        None => shape.is_free(v.translation, radius),
        Some(arm) => shape.has_room(arm, radius, anchor, v.translation),
    });
    views
}
