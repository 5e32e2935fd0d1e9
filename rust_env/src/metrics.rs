//! Truth x belief: the measurements that rewards, success tests and tables are made of.
use crate::belief::Belief;
use crate::world::ground_truth::GroundTruth;
use serde::{Deserialize, Serialize};

/// Names of the columns, in the order of [`StepMetrics::write`].
pub const METRICS: [&str; 13] = [
    "new_surface_voxels",
    "coverage",
    "information_gain_bits",
    "uncertainty_gain",
    "entropy",
    "information",
    "known_voxels",
    "occupied_voxels",
    "travel",
    "path_length",
    "contact",
    "views",
    "time",
];

/// What can be said of a map at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// Surface voxels (those that sight can reach) that the map holds as occupied.
    pub surface: u64,
    /// Bits of entropy over the exploration bounds; an unknown voxel counts one bit.
    pub entropy: f64,
    /// Sum of 1 - u over the occupied voxels (Lluvia 2023, Eq. 11).
    pub information: f64,
    pub known: u64,
    pub occupied: u64,
}

impl Snapshot {
    pub fn of(belief: &Belief, truth: &GroundTruth) -> Self {
        let octree = belief.octree();
        let surface = octree
            .bricks()
            .iter()
            .enumerate()
            .filter_map(|(i, brick)| {
                truth
                    .words(octree.brick_coordinates(i))
                    .map(|words| (brick, words))
            })
            .map(|(brick, words)| {
                let both = brick
                    .occupied
                    .iter()
                    .zip(words)
                    .map(|(a, b)| (a & b).count_ones());
                u64::from(both.sum::<u32>())
            })
            .sum();
        Self {
            surface,
            entropy: belief.volume() as f64 - octree.information_bits(),
            information: octree.information(),
            known: octree.num_known(),
            occupied: octree.num_occupied(),
        }
    }
}

/// The measurements of one step. Gains are differences to the step before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepMetrics {
    pub before: Snapshot,
    pub after: Snapshot,
    /// Surface voxels that sight can reach.
    pub reachable_surface: u64,
    /// Metres in this step and in the episode.
    pub travel: f64,
    pub path_length: f64,
    pub contact: bool,
    pub views: u32,
    /// Simulated seconds.
    pub time: f64,
}

impl StepMetrics {
    pub fn write(&self, row: &mut [f64]) {
        let (a, b) = (&self.after, &self.before);
        let values = [
            a.surface as f64 - b.surface as f64,
            a.surface as f64 / self.reachable_surface.max(1) as f64,
            b.entropy - a.entropy,
            a.information - b.information,
            a.entropy,
            a.information,
            a.known as f64,
            a.occupied as f64,
            self.travel,
            self.path_length,
            f64::from(u8::from(self.contact)),
            f64::from(self.views),
            self.time,
        ];
        row.copy_from_slice(&values);
    }
}
