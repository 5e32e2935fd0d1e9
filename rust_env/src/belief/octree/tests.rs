use super::*;
use crate::belief::testing::{empty, keys, observe, random, RESOLUTION};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::collections::HashMap;

const STATES: [State; 3] = [State::Unknown, State::Free, State::Occupied];

fn books_balance(octree: &Octree) {
    let counted = (
        octree.num_known(),
        octree.num_occupied(),
        octree.entropy(),
        octree.information(),
    );
    assert_eq!(octree.recount(), counted);
}

fn random_box(rng: &mut Pcg64Mcg, half: i32) -> KeyBox {
    let mut corner = || IVec3::from_array(std::array::from_fn(|_| rng.random_range(-half..=half)));
    let (a, b) = (corner(), corner());
    KeyBox {
        min: a.min(b),
        max: a.max(b),
    }
}

#[test]
fn a_mirror_that_is_told_the_changes_equals_the_map() {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    for round in 0..20 {
        let mut octree = random(round, 6, [2, 2, 1]);
        let mut mirror: HashMap<IVec3, State> = HashMap::new();
        for step in 0..12 {
            for change in octree.changed() {
                let old = mirror.insert(change.key, change.after);
                assert_eq!(old.unwrap_or(State::Unknown), change.before);
                assert_ne!(change.before, change.after);
            }
            for key in keys(IVec3::splat(-17), IVec3::splat(17)) {
                let mirrored = mirror.get(&key).copied().unwrap_or(State::Unknown);
                assert_eq!(octree.state(key), mirrored, "round {round} step {step}");
            }
            assert!(octree.changed().is_empty(), "nothing happened in between");
            for _ in 0..rng.random_range(1..4) {
                let voxels = random_box(&mut rng, 16);
                match rng.random_range(0..5) {
                    0 => octree.clear_box(&voxels),
                    1 => octree.decay(0.5, 0.3, Some(&voxels)).unwrap(),
                    2 => octree.clear(),
                    n => {
                        let some: Vec<_> = (0..50).map(|_| random_box(&mut rng, 16).min).collect();
                        observe(&mut octree, some, n == 3, 0.2);
                    }
                }
                books_balance(&octree);
            }
        }
    }
}

#[test]
fn asking_for_changes_changes_nothing() {
    let mut asked = random(3, 8, [1, 1, 1]);
    let mut not_asked = asked.clone();
    asked.changed();
    for octree in [&mut asked, &mut not_asked] {
        observe(octree, keys(IVec3::splat(-3), IVec3::splat(12)), true, 0.1);
    }
    for state in STATES {
        assert_eq!(asked.keys(state), not_asked.keys(state));
    }
    assert_eq!(asked.recount(), not_asked.recount());
    // A voxel that changes back is no change.
    let key = IVec3::splat(30);
    asked.changed();
    observe(&mut asked, [key], true, 0.1);
    asked.clear_box(&KeyBox {
        min: key,
        max: key + 1,
    });
    assert!(asked.changed().is_empty());
}

#[test]
fn a_cleared_box_is_unknown_and_the_rest_untouched() {
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    for seed in 0..10 {
        let before = random(seed, 9, [1, 2, 2]);
        let voxels = random_box(&mut rng, 12);
        let mut after = before.clone();
        after.clear_box(&voxels);
        books_balance(&after);
        for key in keys(IVec3::splat(-13), IVec3::splat(13)) {
            if voxels.contains(key) {
                assert_eq!(
                    (after.state(key), after.uncertainty(key)),
                    (State::Unknown, 1.0)
                );
            } else {
                assert_eq!(after.log_odds(key), before.log_odds(key));
                assert_eq!(after.uncertainty(key), before.uncertainty(key));
            }
        }
        assert_eq!(after.counts_in(&voxels), [voxels.volume(), 0, 0]);
    }
}

#[test]
fn decay_follows_its_law() {
    for (seed, factor, forget_below) in
        [(1, 0.9, 0.1), (2, 0.3, 0.5), (3, 1.0, 1e-6), (4, 0.0, 0.1)]
    {
        let before = random(seed, 7, [1, 2, 2]);
        let mut after = before.clone();
        after.decay(factor, forget_below, None).unwrap();
        books_balance(&after);
        for key in keys(IVec3::splat(-8), IVec3::splat(8)) {
            let expected = before
                .log_odds(key)
                .map(|l| l * factor)
                .filter(|l| l.abs() >= forget_below);
            assert_eq!(after.log_odds(key), expected);
            if expected.is_some() {
                assert_eq!(after.state(key), before.state(key));
                assert_eq!(after.uncertainty(key), before.uncertainty(key));
            }
        }
    }
    // By hand: one hit is ln(0.7 / 0.3) = 0.847; halved three times it is 0.106, halved again it is below 0.1.
    let mut octree = empty();
    observe(&mut octree, [IVec3::ZERO], true, 0.5);
    for _ in 0..3 {
        octree.decay(0.5, 0.1, None).unwrap();
    }
    assert!((octree.log_odds(IVec3::ZERO).unwrap() - 0.105_912).abs() < 1e-6);
    octree.decay(0.5, 0.1, None).unwrap();
    assert_eq!(octree.log_odds(IVec3::ZERO), None);
    for (factor, below) in [
        (-0.1, 0.1),
        (1.1, 0.1),
        (f32::NAN, 0.1),
        (0.5, 0.0),
        (0.5, f32::INFINITY),
    ] {
        assert!(octree.decay(factor, below, None).is_err());
    }
}

#[test]
fn voxels_of_a_box_are_those_of_a_loop() {
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    for seed in 0..10 {
        let octree = random(seed, 9, [3, 2, 1]);
        let voxels = random_box(&mut rng, 20);
        let all: Vec<_> = keys(voxels.min, voxels.max).collect();
        for (i, state) in STATES.into_iter().enumerate() {
            let mut got = octree.keys_in(state, &voxels).unwrap();
            assert_eq!(octree.counts_in(&voxels)[i], got.len() as u64);
            got.sort_unstable_by_key(|k| (k.z, k.y, k.x));
            let expected: Vec<_> = all
                .iter()
                .copied()
                .filter(|k| octree.state(*k) == state)
                .collect();
            assert_eq!(got, expected);
        }
    }
    let everything = KeyBox {
        min: IVec3::splat(-KEY_LIMIT),
        max: IVec3::splat(KEY_LIMIT),
    };
    assert!(empty().keys_in(State::Unknown, &everything).is_err());
    assert_eq!(empty().counts_in(&everything), [1 << 48, 0, 0]);
}

#[test]
fn a_box_in_metres_holds_the_voxels_centred_in_it() {
    let octree = empty();
    let boxed = |a: [f32; 3], b: [f32; 3]| {
        KeyBox::centered_in(&octree, &Aabb::new(Vec3::from(a), Vec3::from(b)))
    };
    let metre = boxed([0.0; 3], [1.0; 3]);
    assert_eq!((metre.min, metre.max), (IVec3::ZERO, IVec3::splat(10)));
    let odd = boxed([-0.26, 0.04, 0.06], [0.14, 0.06, 0.14]);
    assert_eq!(
        (odd.min, odd.max),
        (IVec3::new(-3, 0, 1), IVec3::new(1, 1, 1))
    );
    assert_eq!(odd.volume(), 0);
    let huge = boxed([-1e30; 3], [1e30; 3]);
    assert_eq!(huge.volume(), 1 << 48);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn nearest_is_the_nearest_of_all(seed in 0u64..1000, point in prop::array::uniform3(-3.0f32..3.0), range in 0.0f64..4.0,
                                     weights in prop::array::uniform3(1u32..30), limited in any::<bool>()) {
        let mut octree = random(seed, 7, weights);
        if limited {
            let bounds = Aabb::new(Vec3::splat(-0.55), Vec3::splat(0.85));
            let mut copy = empty().limited_to(&bounds).unwrap();
            for state in [State::Free, State::Occupied] {
                observe(&mut copy, octree.keys(state), state == State::Occupied, 0.1);
            }
            octree = copy;
        }
        let point = Vec3::from(point);
        for state in STATES {
            let distance = |k: IVec3| {
                ((k.as_dvec3() + 0.5) - point.as_dvec3() * (1.0 / RESOLUTION)).length_squared()
            };
            let expected = keys(IVec3::splat(-45), IVec3::splat(45))
                .filter(|k| octree.state(*k) == state)
                .filter(|k| state != State::Unknown || octree.limits().is_none_or(|l| l.contains(*k)))
                .map(|k| (distance(k), (k.z, k.y, k.x)))
                .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
                .filter(|(d, _)| d.sqrt() * RESOLUTION <= range);
            let got = octree.nearest(point, state, range).unwrap();
            prop_assert_eq!(got.map(|(k, _)| (k.z, k.y, k.x)), expected.map(|e| e.1));
            if let (Some((_, metres)), Some((squared, _))) = (got, expected) {
                prop_assert!((metres - squared.sqrt() * RESOLUTION).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn nearest_of_far_and_odd_points() {
    let mut octree = empty();
    let far = f64::INFINITY;
    assert_eq!(
        octree.nearest(Vec3::ZERO, State::Occupied, far).unwrap(),
        None
    );
    let (key, distance) = octree
        .nearest(Vec3::splat(0.01), State::Unknown, far)
        .unwrap()
        .unwrap();
    assert_eq!(key, IVec3::ZERO);
    assert!((distance - 3f64.sqrt() * 0.04).abs() < 1e-7);
    observe(&mut octree, [IVec3::ZERO], true, 0.1);
    for point in [Vec3::new(3000.0, -3000.0, 3000.0), Vec3::X * -3276.0] {
        let (key, distance) = octree
            .nearest(point, State::Occupied, far)
            .unwrap()
            .unwrap();
        assert_eq!(key, IVec3::ZERO);
        assert!((distance - f64::from(point.distance(Vec3::splat(0.05)))).abs() < 1e-2);
        assert_eq!(octree.nearest(point, State::Occupied, 100.0).unwrap(), None);
    }
    for point in [Vec3::NAN, Vec3::INFINITY, Vec3::splat(1e30)] {
        assert_eq!(octree.nearest(point, State::Occupied, far).unwrap(), None);
    }
    assert_eq!(
        octree
            .nearest(Vec3::ZERO, State::Occupied, f64::NAN)
            .unwrap(),
        None
    );
}
