//! What is: geometry, motion, sensing. Knows nothing of the belief wing.
pub mod assets;
pub mod bytes;
pub mod ground_truth;
pub mod motion;
pub mod placement;
pub mod render;
pub mod scene;
pub mod scene_cache;
pub mod scenes;

use crate::camera::Camera;
use crate::geometry::{Pose, Vec3};
use crate::robot::Robot;
pub use assets::{SceneAssets, SceneSource};
use motion::{Motion, Physics};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What of a world is not given by its scene and robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorldState {
    pose: [f32; 7],
    time: f64,
}

/// The true state of one episode.
#[derive(Clone)]
pub struct World {
    assets: Arc<SceneAssets>,
    physics: Physics,
    robot: Robot,
    pose: Pose,
    time: f64,
}

impl World {
    pub fn new(assets: &Arc<SceneAssets>, robot: &Robot, start: Pose) -> Self {
        let physics = Physics::new(&assets.shape, robot.radius(), start.translation);
        Self {
            assets: assets.clone(),
            physics,
            robot: robot.clone(),
            pose: start,
            time: 0.0,
        }
    }

    /// What [`World::load`] needs to go on from here.
    pub fn save(&self) -> WorldState {
        WorldState {
            pose: self.pose.to_array(),
            time: self.time,
        }
    }

    /// A world as it was saved; an error if the state holds no pose.
    pub fn load(assets: &Arc<SceneAssets>, robot: &Robot, state: &WorldState) -> crate::Result<Self> {
        let mut world = Self::new(assets, robot, Pose::from_array(state.pose)?);
        world.time = state.time;
        Ok(world)
    }

    /// Move along way-points to a goal, stop at the first contact, turn to the goal's orientation; the clock runs.
    pub fn follow(&mut self, path: &[Vec3], goal: &Pose) -> Motion {
        let motion = self.physics.follow(path);
        self.time += f64::from(
            self.robot
                .duration(motion.travelled, self.pose.angle_to(goal)),
        );
        self.pose = Pose::new(motion.end, goal.rotation);
        motion
    }

    /// Take a depth image.
    pub fn look(&self, camera: &Camera, image: &mut [f32]) {
        self.assets.renderer.render(camera, &self.pose, image);
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
