//! *What is simulated*: the values that an episode is made of. A default stands where the value is named.
use crate::belief::integrate::Integration;
use crate::belief::octree::SensorModel;
use crate::belief::viewpoints::ViewSpace;
use crate::camera::Camera;
use crate::error::{positive, Error, Result};
use crate::robot::Robot;
use crate::world::bodies::{BodiesSpec, MIN_ROBOT_SPEED};
use crate::world::lidar::Lidar;
use crate::world::noise::DepthNoise;
use crate::world::scenes::KINDS;
use crate::world::SceneSource;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use std::path::{Component, Path, PathBuf};

/// Which scene an episode takes place in.
#[derive(Clone, Debug, PartialEq)]
pub enum SceneChoice {
    File(PathBuf),
    /// A generated scene with a seed drawn from `first..=last`.
    Generated {
        kind: String,
        first: u64,
        last: u64,
    },
}

impl SceneChoice {
    /// Number of different scenes of a kind when none is said: enough to vary, few enough to stay in memory.
    pub const DEFAULT_SEEDS: u64 = 64;

    /// A path to a scene file, or `kind`, `kind:seed`, `kind:first-last` for a generated one.
    pub fn parse(text: &str) -> Result<Self> {
        let (kind, seeds) = match text.split_once(':') {
            Some((kind, seeds)) => (kind, Some(seeds)),
            None => (text, None),
        };
        if !KINDS.contains(&kind) {
            if Path::new(text).exists() {
                return Ok(Self::File(PathBuf::from(text)));
            }
            let source = std::io::Error::new(
                std::io::ErrorKind::NotFound,
                format!(
                    "no such scene file, and no generated kind (those are {})",
                    KINDS.join(", ")
                ),
            );
            return Err(Error::io(Path::new(text), source));
        }
        let number = |s: &str| {
            s.trim().parse::<u64>().map_err(|_| {
                Error::invalid(format!(
                    "scene {text:?}: {s:?} is not a seed (a number >= 0)"
                ))
            })
        };
        let (first, last) = match seeds {
            None => (0, Self::DEFAULT_SEEDS - 1),
            Some(range) => match range.split_once('-') {
                Some((first, last)) => (number(first)?, number(last)?),
                None => (number(range)?, number(range)?),
            },
        };
        if first > last {
            return Err(Error::invalid(format!(
                "scene {text:?}: the first seed {first} is above the last {last}"
            )));
        }
        Ok(Self::Generated {
            kind: kind.to_owned(),
            first,
            last,
        })
    }

    /// The scene of the next episode.
    pub fn draw(&self, rng: &mut Pcg64Mcg) -> SceneSource {
        match self {
            Self::File(path) => SceneSource::File(path.clone()),
            Self::Generated { kind, first, last } => SceneSource::Generated {
                kind: kind.clone(),
                seed: rng.random_range(*first..=*last),
            },
        }
    }

    /// Whether an episode can take place there. A file may lie in another folder now, as far as its own path does not say.
    pub fn has(&self, source: &SceneSource) -> bool {
        match (self, source) {
            (Self::File(path), SceneSource::File(there)) => {
                let named = |c: &Component| !matches!(c, Component::CurDir);
                let path = path.components().rev().filter(named);
                let mut there = there.components().rev().filter(named);
                path.map(Some).all(|part| part == there.next())
            }
            (Self::Generated { kind, first, last }, SceneSource::Generated { kind: k, seed }) => {
                kind == k && (first..=last).contains(&seed)
            }
            _ => false,
        }
    }
}

/// The map that the robot builds.
#[derive(Clone, Debug, PartialEq)]
pub struct MapSpec {
    /// Side of a voxel, metres.
    pub resolution: f64,
    /// Ranges beyond this free space up to it and hit nothing, metres.
    pub max_range: f64,
    pub sensor: SensorModel,
    /// How images are put in; exact by default.
    pub integration: Integration,
    /// Keep for every voxel from where it was seen (Wang 2019).
    pub view_history: bool,
}

/// Most voxels that the exploration bounds may hold (a brick of 512 takes 2.2 kB).
pub const MAX_MAP_VOXELS: u64 = 1 << 30;

impl MapSpec {
    pub fn new(resolution: f64, max_range: f64, sensor: SensorModel) -> Result<Self> {
        positive("map resolution", resolution)?;
        positive("map max_range", max_range)?;
        if max_range / resolution > 4096.0 {
            return Err(Error::invalid(format!(
                "map max_range {max_range} m is more than 4096 voxels of {resolution} m"
            )));
        }
        Ok(Self {
            resolution,
            max_range,
            sensor,
            integration: Integration::default(),
            view_history: false,
        })
    }
}

/// The egocentric window of the map that an observation shows: `size`^3 cells around the camera, turned by its
/// heading, `cell` metres each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalMap {
    pub size: usize,
    pub cell: f64,
}

impl LocalMap {
    pub fn new(size: usize, cell: f64) -> Result<Self> {
        if size == 0 || size > 256 {
            return Err(Error::invalid(format!(
                "local_map size must be 1..=256 cells, got {size}"
            )));
        }
        positive("local_map cell", cell)?;
        Ok(Self { size, cell })
    }
    pub fn cells(&self) -> usize {
        self.size * self.size * self.size
    }
}

/// Which surface voxels coverage is measured against.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Truth {
    /// Those that some view of the task can see, from anywhere within its image.
    #[default]
    Sight,
    /// Those that the map holds after a perfect image from each view of the task, in their order (Wang 2019, section
    /// VI-B: the full dome path counts as 100 %).
    Images,
}

impl Truth {
    pub fn parse(name: &str) -> Result<Self> {
        match name {
            "sight" => Ok(Self::Sight),
            "images" => Ok(Self::Images),
            _ => Err(Error::invalid(format!(
                "truth must be 'sight' or 'images', got {name:?}"
            ))),
        }
    }
}

#[derive(Clone, Debug)]
pub struct Setup {
    pub scene: SceneChoice,
    pub camera: Camera,
    pub robot: Robot,
    pub map: MapSpec,
    pub views: ViewSpace,
    pub local_map: Option<LocalMap>,
    /// Noise of the depth images.
    pub noise: Option<DepthNoise>,
    pub lidar: Option<Lidar>,
    /// What moves besides the robot.
    pub bodies: BodiesSpec,
    pub truth: Truth,
}

impl Setup {
    /// This value if its parts fit together.
    pub fn checked(self) -> Result<Self> {
        let slowest = self.robot.speed().min(self.robot.turn_rate());
        if !self.bodies.is_empty() && slowest < MIN_ROBOT_SPEED {
            return Err(Error::invalid(format!(
                "robot speed and turn_rate must be at least {MIN_ROBOT_SPEED} m/s and rad/s among bodies, got {slowest}"
            )));
        }
        if let Some(arm) = self.robot.arm() {
            let ViewSpace::Dome { radius, .. } = self.views else {
                return Err(Error::invalid(format!(
                    "robot kind 'arm' stands in the middle of a dome: it needs views of kind 'dome', got {:?}",
                    self.views
                )));
            };
            let (nearest, farthest) = arm.reach();
            if !(nearest..=farthest).contains(&radius) {
                return Err(Error::invalid(format!(
                    "dome radius {radius} m is out of the arm's reach: upper_arm {} m and forearm {} m reach {nearest} to {farthest} m",
                    arm.upper_arm, arm.forearm
                )));
            }
        }
        if self.truth == Truth::Images && !self.views.is_fixed() {
            return Err(Error::invalid(
                "truth 'images' needs views that stay where they are (a dome or a ring): six_directions has no last one",
            ));
        }
        Ok(self)
    }

    /// Whether any sensor needs random numbers.
    pub fn is_noisy(&self) -> bool {
        self.noise.is_some() || self.lidar.as_ref().is_some_and(|l| l.sigma > 0.0)
    }
}
