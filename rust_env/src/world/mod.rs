//! What is: geometry, motion, sensing. Knows nothing of the belief wing.
pub mod bodies;
pub mod ground_truth;
pub mod lidar;
pub mod motion;
pub mod noise;
pub mod placement;
pub mod render;
pub mod scene;
pub mod scenes;

use crate::camera::Camera;
use crate::error::Result;
use crate::geometry::{Pose, Vec3};
use crate::robot::Robot;
use bodies::Bodies;
use ground_truth::{GroundTruth, VoxelSet};
use lidar::Lidar;
use motion::{Motion, Physics, SceneShape};
use noise::{DepthNoise, Disturbance};
use render::DepthRenderer;
use scene::Scene;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::SystemTime;

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
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

/// The true state of one episode.
#[derive(Clone)]
pub struct World {
    assets: Arc<SceneAssets>,
    physics: Physics,
    robot: Robot,
    pose: Pose,
    time: f64,
    bodies: Bodies,
    noise: Option<DepthNoise>,
    disturbance: Disturbance,
    /// Working space of the noise.
    perfect: Vec<f32>,
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
            bodies: Bodies::default(),
            noise: None,
            disturbance: Disturbance::new(0),
            perfect: Vec::new(),
        }
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
        let motion = if self.bodies.is_empty() {
            let motion = self.physics.follow(path);
            self.time += f64::from(self.robot.duration(motion.travelled, turn));
            motion
        } else {
            let (from, shape) = (self.physics.position(), self.physics.shape());
            let motion = self
                .bodies
                .follow(shape, &self.robot, from, path, turn, &mut self.time);
            self.physics.move_to(motion.end);
            motion
        };
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
