//! What is: geometry, motion, sensing. Knows nothing of the belief wing.
pub mod arm_motion;
pub mod assets;
pub mod bodies;
pub mod bytes;
pub mod ground_truth;
pub mod inspection;
pub mod lidar;
pub mod motion;
pub mod noise;
pub mod object_grid;
pub mod placement;
pub mod render;
pub mod scene;
pub mod scene_cache;
pub mod scenes;

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::geometry::{Pose, Vec3};
use crate::robot::Robot;
use arm_motion::StandingArm;
pub use assets::{SceneAssets, SceneSource};
use bodies::Bodies;
use lidar::Lidar;
use motion::{Motion, Physics};
use noise::{DepthNoise, Disturbance};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What of a world is not given by its scene and robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorldState {
    pose: [f32; 7],
    pub time: f64,
    bodies: Bodies,
    disturbance: Disturbance,
    /// Shoulder and posture of an arm.
    arm: Option<[f32; 6]>,
}

/// The true state of one episode.
#[derive(Clone)]
pub struct World {
    assets: Arc<SceneAssets>,
    physics: Physics,
    robot: Robot,
    arm: Option<StandingArm>,
    pose: Pose,
    time: f64,
    bodies: Bodies,
    noise: Option<DepthNoise>,
    disturbance: Disturbance,
    /// Working space of the noise.
    perfect: Vec<f32>,
}

impl World {
    /// An arm's shoulder stands where the camera is until [`World::standing_at`] says where.
    pub fn new(assets: &Arc<SceneAssets>, robot: &Robot, start: Pose) -> Self {
        let physics = Physics::new(&assets.shape, robot.radius(), start.translation);
        Self {
            assets: assets.clone(),
            physics,
            robot: robot.clone(),
            arm: None,
            pose: start,
            time: 0.0,
            bodies: Bodies::default(),
            noise: None,
            disturbance: Disturbance::new(0),
            perfect: Vec::new(),
        }
        .standing_at(start.translation)
    }

    /// With the shoulder of its arm, if it has one, at this point; the hand stays.
    pub fn standing_at(mut self, shoulder: Vec3) -> Self {
        let arm = self.robot.arm();
        self.arm = arm
            .map(|arm| StandingArm::new(arm, self.robot.radius(), shoulder, self.pose.translation));
        self
    }

    /// What [`World::load`] needs to go on from here.
    pub fn save(&self) -> WorldState {
        WorldState {
            pose: self.pose.to_array(),
            time: self.time,
            bodies: self.bodies.clone(),
            disturbance: self.disturbance,
            arm: self.arm.as_ref().map(StandingArm::save),
        }
    }

    /// A world as it was saved, with the noise of its setup; an error if the state holds no pose or impossible bodies or arm.
    pub fn load(
        assets: &Arc<SceneAssets>,
        robot: &Robot,
        noise: Option<DepthNoise>,
        state: &WorldState,
    ) -> Result<Self> {
        if !(state.time.is_finite() && state.time >= 0.0) {
            return Err(Error::invalid(format!(
                "a world's time must be finite and >= 0 s, got {}",
                state.time
            )));
        }
        state.bodies.check(state.time)?;
        let mut world = Self::new(assets, robot, Pose::from_array(state.pose)?);
        world.time = state.time;
        world.bodies = state.bodies.clone();
        world.noise = noise;
        world.disturbance = state.disturbance;
        world.arm = match (robot.arm(), state.arm) {
            (None, None) => None,
            (Some(arm), Some(held)) => Some(StandingArm::load(arm, robot.radius(), held)?),
            _ => {
                let message = "a world was saved with an arm and is loaded without one, or the other way round";
                return Err(Error::invalid(message));
            }
        };
        Ok(world)
    }

    /// With bodies that move.
    pub fn with_bodies(mut self, bodies: Bodies) -> Self {
        self.bodies = bodies;
        self
    }

    /// With noise in its depth images; `seed` also begins the noise of scans.
    pub fn with_noise(mut self, noise: Option<DepthNoise>, seed: u64) -> Self {
        self.noise = noise;
        self.disturbance = Disturbance::new(seed);
        self
    }

    /// Move along way-points to a goal, stop at the first contact, turn to the goal's orientation; the clock runs.
    pub fn follow(&mut self, path: &[Vec3], goal: &Pose) -> Motion {
        let turn = self.pose.angle_to(goal);
        let (from, robot, time) = (self.physics.position(), &self.robot, &mut self.time);
        let shape = self.physics.shape();
        let motion = match (&mut self.arm, self.bodies.is_empty()) {
            (None, true) => self.physics.follow(path),
            (None, false) => self.bodies.follow(shape, robot, from, path, turn, time),
            (Some(arm), true) => arm.follow(shape, from, path, arm_motion::STEP, |_, _, _| true),
            (Some(arm), false) => self
                .bodies
                .follow_arm(shape, robot, arm, from, path, turn, time),
        };
        if self.bodies.is_empty() {
            self.time += f64::from(self.robot.duration(motion.travelled, turn));
        }
        if self.arm.is_some() || !self.bodies.is_empty() {
            self.physics.move_to(motion.end);
        }
        self.pose = Pose::new(motion.end, goal.rotation);
        motion
    }

    /// Take a depth image.
    pub fn look(&mut self, camera: &Camera, image: &mut [f32]) {
        let renderer = &self.assets.renderer;
        renderer.render(camera, &self.pose, image);
        for part in self.bodies.parts() {
            renderer.render_over(&part, camera, &self.pose, image);
        }
        if let Some(noise) = &self.noise {
            let mut rng = self.disturbance.next_stream();
            noise.apply(camera, image, &mut self.perfect, &mut rng);
        }
    }

    /// Take a scan: `lidar.rays` ranges, see [`Lidar`].
    pub fn scan(&mut self, lidar: &Lidar, ranges: &mut [f32]) {
        let mut rng = (lidar.sigma > 0.0).then(|| self.disturbance.next_stream());
        let (origin, directions) = lidar.rays(&self.pose);
        for (range, direction) in ranges.iter_mut().zip(directions) {
            let truth = self.cast(origin, direction, lidar.range);
            *range = lidar.measure(truth, rng.as_mut());
        }
    }

    /// Distance to the first surface, a body's too, along a unit vector; as [`DepthRenderer::cast`].
    pub fn cast(&self, origin: Vec3, direction: Vec3, max_range: f32) -> Option<f32> {
        let renderer = &self.assets.renderer;
        let mut nearest = renderer.cast(origin, direction, max_range);
        for part in self.bodies.parts() {
            let limit = nearest.unwrap_or(max_range);
            nearest = renderer
                .cast_at(&part, origin, direction, limit)
                .or(nearest);
        }
        nearest
    }

    /// Upper arm, forearm and camera of an arm.
    pub fn arm_parts(&self) -> Option<arm_motion::Parts> {
        self.arm.as_ref().map(StandingArm::parts)
    }

    pub fn bodies(&self) -> &Bodies {
        &self.bodies
    }
    pub fn pose(&self) -> Pose {
        self.pose
    }
    /// Simulated seconds since the episode began.
    pub fn time(&self) -> f64 {
        self.time
    }
}

#[cfg(test)]
mod test_scenes;

#[cfg(test)]
mod tests;
