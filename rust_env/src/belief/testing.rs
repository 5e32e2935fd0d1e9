//! Maps for tests, filled without a sensor.
use super::octree::{voxel_in_brick, BrickUpdate, Octree, SensorModel, VOXELS};
use crate::geometry::IVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

pub const RESOLUTION: f64 = 0.1;

pub fn empty() -> Octree {
    Octree::new(RESOLUTION, SensorModel::default()).unwrap()
}

/// Update single voxels: `hit` or missed once each, `uncertainty` for the hit ones.
pub fn observe(
    octree: &mut Octree,
    keys: impl IntoIterator<Item = IVec3>,
    hit: bool,
    uncertainty: f32,
) {
    for key in keys {
        let brick = key >> 3;
        octree.reserve(brick, brick).unwrap();
        let mut bits = [0u64; 8];
        let voxel = voxel_in_brick(key);
        bits[voxel >> 6] |= 1 << (voxel & 63);
        let none = [0; 8];
        octree.apply(&BrickUpdate {
            brick,
            free: if hit { none } else { bits },
            hit: if hit { bits } else { none },
            uncertainty: Some(&[uncertainty; VOXELS]),
        });
    }
}

pub fn keys(low: IVec3, high: IVec3) -> impl Iterator<Item = IVec3> {
    (low.z..high.z).flat_map(move |z| {
        (low.y..high.y).flat_map(move |y| (low.x..high.x).map(move |x| IVec3::new(x, y, z)))
    })
}

/// A room of free voxels `0 <= key < size` inside occupied walls.
pub fn room(size: IVec3) -> Octree {
    let mut octree = empty();
    let inside = |k: &IVec3| k.cmpge(IVec3::ZERO).all() && k.cmplt(size).all();
    observe(&mut octree, keys(IVec3::ZERO, size), false, 1.0);
    observe(
        &mut octree,
        keys(IVec3::NEG_ONE, size + 1).filter(|k| !inside(k)),
        true,
        0.3,
    );
    octree
}

/// Voxels of a box around the origin at random: unknown, free or occupied by the given weights, some seen several times.
pub fn random(seed: u64, half: i32, weights: [u32; 3]) -> Octree {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut octree = empty();
    for key in keys(IVec3::splat(-half), IVec3::splat(half)) {
        let draw = rng.random_range(0..weights.iter().sum::<u32>());
        let uncertainty = rng.random::<f32>();
        let times = rng.random_range(1..6);
        if draw >= weights[0] {
            for _ in 0..times {
                observe(
                    &mut octree,
                    [key],
                    draw >= weights[0] + weights[1],
                    uncertainty,
                );
            }
        }
    }
    octree
}
