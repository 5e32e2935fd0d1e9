//! What is: geometry, motion, sensing. Knows nothing of the belief wing.
pub mod ground_truth;
pub mod motion;
pub mod placement;
pub mod render;
pub mod scene;
pub mod scenes;

use crate::camera::Camera;
use crate::error::Result;
use crate::geometry::{Pose, Vec3};
use crate::robot::Robot;
use ground_truth::{GroundTruth, VoxelSet};
use motion::{Motion, Physics, SceneShape};
use render::DepthRenderer;
use scene::Scene;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::SystemTime;

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneSource {
    File(PathBuf),
    Generated { kind: String, seed: u64 },
}

/// A scene and all that is computed from it once; shared by every episode that takes place in it.
pub struct SceneAssets {
    pub scene: Scene,
    pub renderer: DepthRenderer,
    pub shape: SceneShape,
    pub starts: Vec<(Vec3, f32)>,
    truths: Mutex<Vec<(String, Arc<GroundTruth>)>>,
    stamp: OnceLock<u64>,
}

/// A source and, for a file, its age and size: a changed file is read again.
type CacheKey = (SceneSource, Option<(SystemTime, u64)>);
/// Scenes kept in memory; the one used longest ago goes first.
const CACHED_SCENES: usize = 256;
/// Most recently used last.
type Cache = Mutex<Vec<(CacheKey, Arc<SceneAssets>)>>;
static CACHE: OnceLock<Cache> = OnceLock::new();

impl SceneAssets {
    pub fn new(scene: Scene) -> Result<Self> {
        let renderer = DepthRenderer::new(&scene.visual);
        let shape = SceneShape::new(&scene);
        let starts = if scene.starts.is_empty() {
            placement::find_starts(&scene, &shape, &renderer, 0.0, placement::HEIGHT)
        } else {
            scene.starts.clone()
        };
        Ok(Self {
            scene,
            renderer,
            shape,
            starts,
            truths: Mutex::default(),
            stamp: OnceLock::new(),
        })
    }

    /// The scene of a source, from memory if this process has it already.
    pub fn open(source: &SceneSource) -> Result<Arc<Self>> {
        let stamp = match source {
            SceneSource::File(path) => {
                let meta = std::fs::metadata(path).map_err(|e| crate::Error::io(path, e))?;
                meta.modified().ok().map(|m| (m, meta.len()))
            }
            SceneSource::Generated { .. } => None,
        };
        let key = (source.clone(), stamp);
        let cache = CACHE.get_or_init(Mutex::default);
        let lock = || {
            cache
                .lock()
                .unwrap_or_else(|poisoned| poisoned.into_inner())
        };
        {
            let mut scenes = lock();
            if let Some(i) = scenes.iter().position(|(k, _)| *k == key) {
                let entry = scenes.remove(i);
                let assets = entry.1.clone();
                scenes.push(entry);
                return Ok(assets);
            }
        }
        // Built outside the lock: two threads may build the same scene, which costs time but gives equal scenes.
        let scene = match source {
            SceneSource::File(path) => scenes::load(path, &scenes::LoadOptions::default())?,
            SceneSource::Generated { kind, seed } => scenes::generate(kind, *seed)?,
        };
        let assets = Arc::new(Self::new(scene)?);
        let mut scenes = lock();
        if scenes.len() >= CACHED_SCENES {
            scenes.remove(0);
        }
        scenes.push((key, assets.clone()));
        Ok(assets)
    }

    /// The ground truth of a task, computed once; `key` names everything that it depends on besides the scene.
    pub fn ground_truth(
        &self,
        key: String,
        make: impl FnOnce() -> Result<GroundTruth>,
    ) -> Result<Arc<GroundTruth>> {
        let lock = || {
            self.truths
                .lock()
                .unwrap_or_else(|poisoned| poisoned.into_inner())
        };
        if let Some((_, truth)) = lock().iter().find(|(k, _)| *k == key) {
            return Ok(truth.clone());
        }
        let truth = Arc::new(make()?);
        lock().push((key, truth.clone()));
        Ok(truth)
    }

    /// A digest of the scene's content, whatever file or generator it came from.
    pub fn stamp(&self) -> u64 {
        *self.stamp.get_or_init(|| self.scene.digest())
    }

    /// Centres of the voxels within the bounds that the visual surface touches.
    pub fn surface_voxels(&self, resolution: f64) -> Result<Vec<Vec3>> {
        let set = VoxelSet::surface(&self.scene.visual, &self.scene.bounds, resolution)?;
        let center = |k: crate::geometry::IVec3| ((k.as_dvec3() + 0.5) * resolution).as_vec3();
        Ok(set.keys().into_iter().map(center).collect())
    }

    /// Positions on a lattice that a ball of this radius can float to from `start`: where a free camera can be.
    pub fn reachable_positions(&self, start: Vec3, radius: f32) -> Vec<Vec3> {
        placement::reachable_positions(&self.shape, &self.scene.bounds, start, radius)
    }
}

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
    pub fn load(assets: &Arc<SceneAssets>, robot: &Robot, state: &WorldState) -> Result<Self> {
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
