//! One episode: the only place where truth and knowledge meet.
use crate::belief::viewpoints::ViewSpace;
use crate::belief::{Belief, Prior};
use crate::error::{Error, Result};
use crate::geometry::{Pose, Vec3};
use crate::metrics::{Snapshot, StepMetrics};
use crate::setup::Setup;
use crate::world::ground_truth::{GroundTruth, Sight};
use crate::world::{SceneAssets, World};
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
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
    /// Seconds per stage since the episode began.
    pub seconds: [f64; 6],
}

impl Episode {
    /// A new episode from a seed: its scene, its start, a first image taken there.
    pub fn new(setup: Arc<Setup>, seed: u64) -> Result<Self> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let assets = SceneAssets::open(&setup.scene.draw(&mut rng))?;
        let start = Start::draw(&setup, &assets, &mut rng)?;
        let truth = ground_truth(&setup, &assets, &start)?;
        let prior = Prior {
            bounds: assets.scene.bounds,
            start: start.pose,
            anchor: start.anchor,
        };
        let mut world = World::new(&assets, &setup.robot, start.pose);
        if !setup.bodies.is_empty() {
            let (radius, begin) = (setup.robot.radius(), start.pose.translation);
            world = world.with_bodies(setup.bodies.draw(&assets, radius, begin, &mut rng)?);
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
            belief: Belief::new(&setup, prior)?,
            setup,
            assets,
            truth,
            rng,
        };
        episode.metrics.after = Snapshot::of(&episode.belief, &episode.truth);
        episode.sense()?;
        Ok(episode)
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
        self.metrics.views += 1;
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

    /// A seed for the next episode, from this episode's stream.
    pub fn next_seed(&mut self) -> u64 {
        self.rng.next_u64()
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

/// Where an episode begins.
struct Start {
    pose: Pose,
    /// Centre of the fixed views, if the task has such.
    anchor: Vec3,
}

impl Start {
    fn draw(setup: &Setup, assets: &SceneAssets, rng: &mut Pcg64Mcg) -> Result<Self> {
        let scene = &assets.scene;
        let radius = setup.robot.radius();
        let none = |what: &str| {
            Err(Error::invalid(format!(
                "scene {:?} has no {what} for a body of radius {radius} m",
                scene.name
            )))
        };
        let anchor = match &setup.views {
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
            // The roomiest place.
            ViewSpace::Dome { .. } => match assets.starts.first() {
                Some((position, _)) => *position,
                None => return none("place for a dome"),
            },
            ViewSpace::Ring { .. } => scene.bounds.center(),
        };
        let views = setup.views.views(&Pose::IDENTITY, anchor);
        let free: Vec<&Pose> = views
            .iter()
            .filter(|v| assets.shape.is_free(v.translation, radius))
            .collect();
        match free.choose(rng) {
            Some(pose) => Ok(Self {
                pose: **pose,
                anchor,
            }),
            None => none("free viewpoint"),
        }
    }
}

/// The surface that the task's views could see: computed once per scene, task geometry and start region.
fn ground_truth(setup: &Setup, assets: &SceneAssets, start: &Start) -> Result<Arc<GroundTruth>> {
    let radius = setup.robot.radius();
    let key = format!(
        "{:?} {:?} {:?} {} {radius}",
        setup.views, setup.camera, setup.map, start.anchor
    );
    assets.ground_truth(key, || {
        let map = &setup.map;
        let make = |sight: &Sight| {
            let (scene, range) = (&assets.scene, map.max_range as f32);
            GroundTruth::new(
                &scene.visual,
                &assets.renderer,
                &scene.bounds,
                map.resolution,
                range,
                &setup.camera,
                sight,
            )
        };
        if setup.views.is_fixed() {
            let mut views = setup.views.views(&Pose::IDENTITY, start.anchor);
            views.retain(|v| assets.shape.is_free(v.translation, radius));
            make(&Sight::Views(&views))
        } else {
            make(&Sight::Positions(
                &assets.reachable_positions(start.anchor, radius),
            ))
        }
    })
}
