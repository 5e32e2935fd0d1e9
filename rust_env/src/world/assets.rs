//! A scene and all that is computed from it once; shared by every episode of the process that takes place in it.
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};
use std::time::{Instant, SystemTime};

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_128;

use super::bytes::Writer;
use super::ground_truth::{GroundTruth, VoxelSet};
use super::inspection::{Inspection, Visible};
use super::motion::SceneShape;
use super::object_grid::ObjectGrid;
use super::placement;
use super::render::DepthRenderer;
use super::scene::Scene;
use super::scene_cache::{entry, read_scene, read_truth, Found, SceneCache, SceneEntry};
use super::scenes::disk::{self, Answers};
use super::scenes::{self, LoadOptions};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::geometry::{IVec3, Pose, Vec3};
use crate::interrupt;

/// Where a scene comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SceneSource {
    File(PathBuf),
    Generated { kind: String, seed: u64 },
}

pub struct SceneAssets {
    pub scene: Scene,
    pub renderer: DepthRenderer,
    pub shape: SceneShape,
    pub starts: Vec<(Vec3, f32)>,
    truths: Mutex<Vec<(String, Arc<GroundTruth>)>>,
    /// By what they depend on besides the scene.
    free_views: Mutex<Vec<(String, Arc<Vec<Pose>>)>>,
    /// Once somebody asked which objects are seen.
    objects: OnceLock<ObjectGrid>,
    /// Digest of the scene's content, once somebody asked for it.
    digest: OnceLock<u64>,
    /// Where ground truths of this scene are kept between processes, and the digest of its geometry.
    cache: Option<(SceneCache, u128)>,
}

#[derive(Clone, PartialEq)]
enum Key {
    /// The digest of the path and of how it is read.
    File(u128),
    Generated(String, u64),
}

/// A file's age and size.
type Stamp = Option<(SystemTime, u64)>;

struct Kept {
    key: Key,
    stamp: Stamp,
    /// What the reader asked the disk, if it can be asked again.
    answers: Option<Answers>,
    assets: Arc<SceneAssets>,
}

/// Scenes kept in memory; the one used longest ago goes first.
const MAX_KEPT: usize = 256;
/// Most recently used last.
static KEPT: OnceLock<Mutex<Vec<Kept>>> = OnceLock::new();

fn kept() -> MutexGuard<'static, Vec<Kept>> {
    let scenes = KEPT.get_or_init(Mutex::default);
    scenes
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// From memory, if `good` says so.
fn recall(key: &Key, good: impl Fn(&Kept) -> bool) -> Option<Arc<SceneAssets>> {
    let mut scenes = kept();
    let i = scenes.iter().position(|k| k.key == *key)?;
    let entry = scenes.remove(i);
    if !good(&entry) {
        return None;
    }
    let assets = entry.assets.clone();
    scenes.push(entry);
    Some(assets)
}

fn remember(entry: Kept) {
    let mut scenes = kept();
    scenes.retain(|k| k.key != entry.key);
    if scenes.len() >= MAX_KEPT {
        scenes.remove(0);
    }
    scenes.push(entry);
}

fn stamp(path: &Path) -> Result<Stamp> {
    let metadata = fs::metadata(path).map_err(|e| Error::io(path, e))?;
    Ok(metadata.modified().ok().map(|m| (m, metadata.len())))
}

impl SceneAssets {
    pub fn new(scene: Scene) -> Result<Self> {
        let renderer = DepthRenderer::new(&scene.visual);
        let shape = SceneShape::new(&scene);
        let starts = if scene.starts.is_empty() {
            placement::find_starts(&scene, &shape, &renderer, 0.0, placement::HEIGHT)
        } else {
            scene.starts.clone()
        };
        Ok(Self::of_parts(scene, renderer, shape, starts))
    }

    /// What an entry of the cache gives, and what the disk had to say when it was written.
    pub fn of_entry(entry: SceneEntry) -> (Self, Answers) {
        let shape = SceneShape::new(&entry.scene);
        let assets = Self::of_parts(entry.scene, entry.renderer, shape, entry.starts);
        (assets, entry.answers)
    }

    fn of_parts(
        scene: Scene,
        renderer: DepthRenderer,
        shape: SceneShape,
        starts: Vec<(Vec3, f32)>,
    ) -> Self {
        Self {
            scene,
            renderer,
            shape,
            starts,
            truths: Mutex::default(),
            free_views: Mutex::default(),
            objects: OnceLock::new(),
            digest: OnceLock::new(),
            cache: None,
        }
    }

    /// The scene of a source, from memory if this process has it already and a file has kept its age and size.
    pub fn open(source: &SceneSource) -> Result<Arc<Self>> {
        match source {
            SceneSource::File(path) => {
                let options = LoadOptions::default();
                let (key, stamp) = (Key::File(options.digest(path)), stamp(path)?);
                let unchanged = |kept: &Kept| kept.stamp.is_some() && kept.stamp == stamp;
                match recall(&key, unchanged) {
                    Some(assets) => Ok(assets),
                    None => Self::read(path, &options, SceneCache::of_environment()),
                }
            }
            SceneSource::Generated { kind, seed } => {
                let key = Key::Generated(kind.clone(), *seed);
                if let Some(assets) = recall(&key, |_| true) {
                    return Ok(assets);
                }
                // Built outside the lock: two threads may build the same scene, which costs time but gives equal scenes.
                let assets = Arc::new(Self::new(scenes::generate(kind, *seed)?)?);
                remember(Kept {
                    key,
                    stamp: None,
                    answers: None,
                    assets: assets.clone(),
                });
                Ok(assets)
            }
        }
    }

    /// A scene file, from memory or from the cache on disk if no file that belongs to it has changed.
    ///
    /// # Errors
    /// As [`scenes::load`]. A cache that cannot be read or written is no error: the scene's report says so.
    pub fn load(path: &Path, options: &LoadOptions) -> Result<Arc<Self>> {
        stamp(path)?;
        let key = Key::File(options.digest(path));
        // A copy, so that the disk is asked outside the lock.
        let answers = kept()
            .iter()
            .find(|k| k.key == key)
            .and_then(|k| k.answers.clone());
        if let Some(answers) = answers.filter(Answers::hold) {
            if let Some(assets) = recall(&key, |k| k.answers.as_ref() == Some(&answers)) {
                return Ok(assets);
            }
        }
        Self::read(path, options, SceneCache::of_environment())
    }

    /// As [`SceneAssets::load`], but with a cache on disk of choice and never from memory.
    pub fn read(
        path: &Path,
        options: &LoadOptions,
        cache: Option<SceneCache>,
    ) -> Result<Arc<Self>> {
        let begin = Instant::now();
        let question = options.digest(path);
        let stamp = stamp(path)?;
        let mut note = "new".to_owned();
        let mut made = None;
        if let Some(cache) = &cache {
            let found = match cache.read(question) {
                Found::Nothing => Found::Nothing,
                Found::Bad(fault) => Found::Bad(fault),
                Found::Good(bytes) => match read_scene(&bytes) {
                    Err(fault) => Found::Bad(fault),
                    Ok(entry) if entry.answers.hold() => Found::Good(entry),
                    Ok(_) => Found::Bad("a file has changed"),
                },
            };
            match found {
                Found::Nothing => {}
                Found::Bad(fault) => note = format!("made anew: {fault}"),
                Found::Good(entry) => {
                    let (mut assets, answers) = Self::of_entry(entry);
                    let report = &mut assets.scene.report;
                    report.cache = "read".to_owned();
                    report.load_milliseconds = begin.elapsed().as_secs_f64() * 1e3;
                    made = Some((assets, Some(answers)));
                }
            }
        }
        let (mut assets, answers) = match made {
            Some(made) => made,
            None => {
                let (scene, answers) = disk::recorded(|| scenes::load(path, options));
                let mut assets = Self::new(scene?)?;
                if let Some(cache) = &cache {
                    assets.keep(cache, question, answers.as_ref(), note);
                }
                (assets, answers)
            }
        };
        if let Some(cache) = cache {
            let digest = assets.digest();
            assets.cache = Some((cache, digest));
        }
        let assets = Arc::new(assets);
        remember(Kept {
            key: Key::File(question),
            stamp,
            answers,
            assets: assets.clone(),
        });
        Ok(assets)
    }

    /// Writes the scene to the cache; the report says what came of it.
    fn keep(
        &mut self,
        cache: &SceneCache,
        question: u128,
        answers: Option<&Answers>,
        mut note: String,
    ) {
        let bytes =
            answers.and_then(|a| entry::scene_bytes(a, &self.scene, &self.renderer, &self.starts));
        match bytes.map(|bytes| cache.write(question, &bytes)) {
            None => note += ", not kept: some of its files cannot be named or read",
            Some(Ok(())) => {}
            Some(Err(error)) => {
                let folder = cache.folder().display();
                let warning = format!("{folder}: the scene was not cached: {error}");
                self.scene.report.warnings.push(warning);
                note += ", not kept";
            }
        }
        self.scene.report.cache = note;
    }

    /// Of all that ground truth depends on besides the task.
    fn digest(&self) -> u128 {
        let mut out = Writer::default();
        out.mesh(&self.scene.visual);
        out.mesh(&self.scene.collision);
        out.f32(self.scene.ground_plane.unwrap_or(f32::NAN));
        out.aabb(&self.scene.bounds);
        out.text(&format!("{:?}", self.renderer.isa()));
        xxh3_128(&out.0)
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
        let truth = Arc::new(match &self.cache {
            None => make()?,
            Some((cache, scene)) => {
                let question = xxh3_128(format!("{scene:x} {key}").as_bytes());
                let known = match cache.read(question) {
                    Found::Good(bytes) => read_truth(&bytes).ok(),
                    _ => None,
                };
                match known {
                    Some(truth) => truth,
                    None => {
                        let truth = make()?;
                        // A cache that cannot be written only costs time; the scene's report has said so.
                        let _ = cache.write(question, &entry::truth_bytes(&truth));
                        truth
                    }
                }
            }
        });
        lock().push((key, truth.clone()));
        Ok(truth)
    }

    /// Views that a robot can take, found once; `key` names everything that they depend on besides the scene.
    pub fn free_views(&self, key: String, find: impl FnOnce() -> Vec<Pose>) -> Arc<Vec<Pose>> {
        let lock = || {
            self.free_views
                .lock()
                .unwrap_or_else(|poisoned| poisoned.into_inner())
        };
        if let Some((_, views)) = lock().iter().find(|(k, _)| *k == key) {
            return views.clone();
        }
        let views = Arc::new(find());
        lock().push((key, views.clone()));
        views
    }

    /// A digest of the scene's content, whatever file or generator it came from.
    pub fn stamp(&self) -> u64 {
        *self.digest.get_or_init(|| self.scene.digest())
    }

    /// Centres of the voxels within the bounds that the visual surface touches.
    pub fn surface_voxels(&self, resolution: f64) -> Result<Vec<Vec3>> {
        let set = VoxelSet::surface(&self.scene.visual, &self.scene.bounds, resolution)?;
        let center = |k: IVec3| ((k.as_dvec3() + 0.5) * resolution).as_vec3();
        Ok(set.keys().into_iter().map(center).collect())
    }

    /// What the depth image from each pose shows: within the camera's limits, of the static scene.
    pub fn visible(
        &self,
        camera: &Camera,
        poses: &[Pose],
        resolution: f64,
    ) -> Result<Vec<Visible>> {
        let grid = match self.objects.get() {
            Some(grid) => grid,
            None => {
                let made = ObjectGrid::new(&self.scene)?;
                self.objects.get_or_init(|| made)
            }
        };
        let mut inspection = Inspection::new(&self.scene, &self.renderer, grid);
        let look = |pose| {
            interrupt::check()?;
            Ok(inspection.look(camera, pose, resolution))
        };
        poses.iter().map(look).collect()
    }

    /// Positions on a lattice that a ball of this radius can float to from `start`: where a free camera can be.
    pub fn reachable_positions(&self, start: Vec3, radius: f32) -> Vec<Vec3> {
        placement::reachable_positions(&self.shape, &self.scene.bounds, start, radius)
    }
}
