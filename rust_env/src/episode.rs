//! One episode: the only place where truth and knowledge meet.
mod reference;
mod start;

use crate::belief::octree::Change;
use crate::belief::{Belief, BeliefState};
use crate::error::{Error, Result};
use crate::geometry::{Pose, Vec3};
use crate::metrics::{Snapshot, StepMetrics};
use crate::setup::Setup;
use crate::world::ground_truth::GroundTruth;
use crate::world::{SceneAssets, SceneSource, World, WorldState};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use reference::ground_truth;
use serde::{Deserialize, Serialize};
use start::Start;
use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

/// Stages of a step whose wall-clock time is added up, in the order of the step.
pub const STAGES: [&str; 6] = ["plan", "move", "render", "integrate", "measure", "observe"];

#[derive(Clone)]
pub struct Episode {
    setup: Arc<Setup>,
    assets: Arc<SceneAssets>,
    truth: Arc<GroundTruth>,
    world: World,
    belief: Belief,
    /// The episode's one random stream.
    rng: Pcg64Mcg,
    image: Vec<f32>,
    /// The last scan, empty without a lidar.
    scan: Vec<f32>,
    metrics: StepMetrics,
    source: SceneSource,
    start: Start,
    /// Seconds per stage since the episode began.
    pub seconds: [f64; 6],
}

/// What of an episode is not given by its setup. Wall-clock times are not kept.
#[derive(Serialize, Deserialize)]
pub struct EpisodeState<'a> {
    pub source: SceneSource,
    /// The scene's content, so that another scene under the same name is noticed.
    stamp: u64,
    start: [f32; 7],
    anchor: [f32; 3],
    rng: Pcg64Mcg,
    pub world: WorldState,
    #[serde(borrow)]
    belief: BeliefState<'a>,
    /// The last image, f32 little-endian.
    #[serde(borrow)]
    image: Cow<'a, [u8]>,
    scan: Vec<f32>,
    metrics: StepMetrics,
}

impl Episode {
    /// A new episode from a seed: its scene, its start, a first image taken there.
    pub fn new(setup: Arc<Setup>, seed: u64) -> Result<Self> {
        Self::after(None, setup, seed)
    }

    /// The same, with the memory of the belief of an episode that is over.
    pub fn after(before: Option<Belief>, setup: Arc<Setup>, seed: u64) -> Result<Self> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let source = setup.scene.draw(&mut rng);
        let assets = SceneAssets::open(&source)?;
        let start = Start::draw(&setup, &assets, &mut rng)?;
        let truth = ground_truth(&setup, &assets, start.anchor)?;
        let mut world = World::new(&assets, &setup.robot, start.pose).standing_at(start.anchor);
        if !setup.bodies.is_empty() {
            let radius = setup.robot.radius();
            let (keep_out, begin) = match setup.robot.arm() {
                None => (radius, start.pose.translation),
                Some(arm) => {
                    let hand = start.pose.translation.distance(start.anchor);
                    let thick = radius.max(arm.link_radius);
                    (arm.upper_arm.max(hand) + thick, start.anchor)
                }
            };
            let drawn = setup
                .bodies
                .draw(&assets, radius, keep_out, begin, &mut rng)?;
            world = world.with_bodies(drawn);
        }
        if setup.is_noisy() {
            // Not drawn otherwise: perfect sensors leave the stream as it is.
            world = world.with_noise(setup.noise, rng.next_u64());
        }
        let mut episode = Self {
            image: vec![0.0; setup.camera.pixels()],
            scan: vec![0.0; setup.lidar.as_ref().map_or(0, |l| l.rays)],
            metrics: StepMetrics::default(),
            seconds: [0.0; STAGES.len()],
            world,
            belief: Belief::after(before, &setup, start.prior(&assets))?,
            setup,
            assets,
            truth,
            rng,
            source,
            start,
        };
        episode.metrics.after = Snapshot::of(&episode.belief, &episode.truth);
        episode.sense()?;
        Ok(episode)
    }

    /// What [`Episode::load`] needs to go on from here, bit for bit.
    pub fn save(&self) -> Result<EpisodeState<'static>> {
        let source = match &self.source {
            // Other processes may run in another folder.
            SceneSource::File(path) => {
                SceneSource::File(std::path::absolute(path).map_err(|e| Error::io(path, e))?)
            }
            generated => generated.clone(),
        };
        Ok(EpisodeState {
            source,
            stamp: self.assets.stamp(),
            start: self.start.pose.to_array(),
            anchor: self.start.anchor.to_array(),
            rng: self.rng.clone(),
            world: self.world.save(),
            belief: self.belief.save(),
            image: Cow::Owned(self.image.iter().flat_map(|d| d.to_le_bytes()).collect()),
            scan: self.scan.clone(),
            metrics: self.metrics,
        })
    }

    /// An episode as it was saved. The scene is opened again; it is an error if its content changed. The bytes may come
    /// from anywhere: what does not fit setup or scene is an error.
    pub fn load(setup: Arc<Setup>, state: &EpisodeState) -> Result<Self> {
        if !setup.scene.has(&state.source) {
            return Err(Error::invalid(format!(
                "a snapshot's episode takes place in {:?}, which its setup's scene, {:?}, is not",
                state.source, setup.scene
            )));
        }
        let assets = SceneAssets::open(&state.source)?;
        if assets.stamp() != state.stamp {
            let changed =
                "the scene is not the one that the snapshot was taken in: its content changed";
            return Err(match &state.source {
                SceneSource::File(path) => Error::malformed(path, changed),
                SceneSource::Generated { kind, seed } => {
                    Error::invalid(format!("{kind}:{seed}: {changed}"))
                }
            });
        }
        let start = Start {
            pose: Pose::from_array(state.start)?,
            anchor: Vec3::from_array(state.anchor),
        };
        let pixels = setup.camera.pixels();
        if !start.is_of(&assets) || state.image.len() != pixels * 4 {
            return Err(Error::invalid(format!(
                "a snapshot's episode has an image of {} bytes for {pixels} pixels, or starts at {}, which is no start",
                state.image.len(),
                start.anchor
            )));
        }
        let rays = setup.lidar.as_ref().map_or(0, |l| l.rays);
        if state.scan.len() != rays {
            return Err(Error::invalid(format!(
                "a snapshot's episode has a scan of {} rays, the setup's lidar {rays}",
                state.scan.len()
            )));
        }
        let (pixels, _) = state.image.as_chunks::<4>();
        Ok(Self {
            truth: ground_truth(&setup, &assets, start.anchor)?,
            world: World::load(&assets, &setup.robot, setup.noise, &state.world)?,
            belief: Belief::load(&setup, start.prior(&assets), &state.belief)?,
            rng: state.rng.clone(),
            image: pixels.iter().map(|b| f32::from_le_bytes(*b)).collect(),
            scan: state.scan.clone(),
            metrics: state.metrics,
            source: state.source.clone(),
            seconds: [0.0; STAGES.len()],
            setup,
            assets,
            start,
        })
    }

    /// Go to a viewpoint, look, learn: the loop of active perception.
    pub fn step(&mut self, goal: &Pose) -> Result<()> {
        let started = Instant::now();
        let path = self.belief.plan(goal);
        let planned = Instant::now();
        let motion = self.world.follow(&path, goal);
        self.belief.moved(goal, self.world.pose());
        self.seconds[0] += (planned - started).as_secs_f64();
        self.seconds[1] += planned.elapsed().as_secs_f64();
        self.metrics.travel = f64::from(motion.travelled);
        self.metrics.path_length += self.metrics.travel;
        self.metrics.contact = motion.contact;
        self.metrics.time = self.world.time();
        self.sense()
    }

    fn sense(&mut self) -> Result<()> {
        let started = Instant::now();
        self.world.look(&self.setup.camera, &mut self.image);
        if let Some(lidar) = &self.setup.lidar {
            self.world.scan(lidar, &mut self.scan);
        }
        let looked = Instant::now();
        self.belief.observe(&self.image)?;
        let integrated = Instant::now();
        self.metrics.before = self.metrics.after;
        self.metrics.after = Snapshot::of(&self.belief, &self.truth);
        self.metrics.reachable_surface = self.truth.count();
        self.metrics.views = self.metrics.views.saturating_add(1);
        self.seconds[2] += (looked - started).as_secs_f64();
        self.seconds[3] += (integrated - looked).as_secs_f64();
        self.seconds[4] += integrated.elapsed().as_secs_f64();
        Ok(())
    }

    /// The metrics that a step to `goal` would give; nothing changes. For oracles only: it looks at the truth.
    pub fn foresee(&self, goal: &Pose) -> Result<StepMetrics> {
        let mut fork = self.clone();
        fork.step(goal)?;
        Ok(fork.metrics)
    }

    /// Whether contact would stop the robot on its way to `goal`; nothing changes. For oracles only.
    pub fn foresee_contact(&self, goal: &Pose) -> bool {
        let path = self.belief.plan(goal);
        self.world.clone().follow(&path, goal).contact
    }

    /// What of an episode that is over the next one takes over.
    pub fn into_belief(self) -> Belief {
        self.belief
    }

    /// A seed for the next episode, from this episode's stream.
    pub fn next_seed(&mut self) -> u64 {
        self.rng.next_u64()
    }

    /// The voxels of the map whose state changed since the last call, or since the episode began.
    pub fn changed(&mut self) -> Vec<Change> {
        self.belief.changed()
    }

    pub fn setup(&self) -> &Arc<Setup> {
        &self.setup
    }
    pub fn assets(&self) -> &Arc<SceneAssets> {
        &self.assets
    }
    pub fn truth(&self) -> &GroundTruth {
        &self.truth
    }
    pub fn world(&self) -> &World {
        &self.world
    }
    pub fn belief(&self) -> &Belief {
        &self.belief
    }
    pub fn image(&self) -> &[f32] {
        &self.image
    }
    /// Ranges of the lidar's last scan, metres; empty without a lidar.
    pub fn scan(&self) -> &[f32] {
        &self.scan
    }
    pub fn metrics(&self) -> &StepMetrics {
        &self.metrics
    }
}
