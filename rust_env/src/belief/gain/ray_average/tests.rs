use super::super::{directions, view_gain_with, Gain, RaySpacing};
use super::*;
use crate::belief::octree::{probability, voxel_in_brick, Octree, SensorModel, State};
use crate::belief::ray_walk::Dda;
use crate::belief::testing::{empty, keys, observe, random};
use crate::belief::view_history::{confidence, ELEVATIONS, LAYER, UNIT};
use crate::camera::Camera;
use crate::geometry::{Aabb, Quat};
use proptest::prelude::*;
use std::f32::consts::PI;

const GAINS: [Gain; 3] = [Gain::ViewHistory, Gain::RayEntropy, Gain::RayProbability];

fn camera(near: f64) -> Camera {
    Camera::from_fov(32, 24, 1.03, 0.80, near, 4.0).unwrap()
}

fn h(p: f64) -> f64 {
    -p * p.log2() - (1.0 - p) * (1.0 - p).log2()
}

/// Eq. 3 and the section's prose, voxel by voxel and in f64.
fn reference(
    octree: &Octree,
    view: &Pose,
    camera: &Camera,
    gain: Gain,
    range: f64,
    bounds: Option<Aabb>,
) -> f64 {
    let bounds = bounds.map(|b| KeyBox::touching(octree, &b));
    let sectors = Sectors::new(view.translation);
    let utility = |key: IVec3| -> f64 {
        let log_odds = octree.log_odds(key).unwrap();
        let p = probability(log_odds);
        match gain {
            Gain::RayEntropy => h(p),
            Gain::RayProbability => 1.0 - (2.0 * p - 1.0).abs(),
            _ => {
                let history = octree.view_history().unwrap();
                let brick = octree
                    .root()
                    .brick(octree.root().index(key >> 3).unwrap())
                    .unwrap();
                let (z, i) = (voxel_in_brick(key) / LAYER, voxel_in_brick(key) % LAYER);
                let sum = history.total(brick, z).map_or(0, |t| t.confidence[i]);
                if sum == 0 {
                    return 1.0;
                }
                let direction = sectors.direction(octree.center(key));
                let here = history
                    .block(brick, z, direction)
                    .filter(|(_, b)| b.confidence[i] > 0);
                let now = here.map_or(UNIT, |(_, b)| confidence(b.log_odds[i]));
                (f64::from(now) / f64::from(sum)).min(1.0)
            }
        }
    };
    let rotation = Mat3::from_quat(view.rotation);
    let rays = directions(camera, 1);
    let mut sum = 0.0;
    for d in &rays {
        let d = Vec3::from_array(super::super::rays::turned(&rotation, *d));
        let start = octree.key(view.translation).unwrap();
        let mut dda = Dda::new(octree.resolution(), start, view.translation, d);
        let (mut total, mut count, mut entry) = (0.0, 0, 0.0);
        let mut new = false;
        loop {
            let inside = bounds.is_none_or(|b| b.contains(dda.key));
            let state = octree.state(dda.key);
            if inside && entry >= f64::from(camera.near) {
                if state == State::Unknown && gain == Gain::ViewHistory {
                    new = true;
                    break;
                }
                if state != State::Unknown {
                    total += utility(dda.key);
                    count += 1;
                }
            }
            if state == State::Occupied {
                break;
            }
            entry = dda.advance();
            if entry > range {
                break;
            }
        }
        sum += if new {
            1.0
        } else if count == 0 {
            0.0
        } else {
            total / f64::from(count)
        };
    }
    sum / rays.len() as f64
}

fn views() -> Vec<Pose> {
    [
        ([0.33, 0.21, 0.47], 0.3, 0.1),
        ([0.9, 0.8, 0.52], 2.3, -0.4),
        ([-0.41, 0.35, 0.12], 4.0, 1.2),
        ([1.9, 1.7, 0.3], 3.6, -0.1),
    ]
    .map(|(t, yaw, pitch)| Pose::from_yaw_pitch(Vec3::from_array(t), yaw, pitch))
    .to_vec()
}

/// A map with a view history, whose occupied voxels are few enough to look past.
fn seen(seed: u64, weights: [u32; 3]) -> Octree {
    let mut octree = random(seed, 14, weights).with_view_history();
    for view in &views()[..3] {
        octree.record_view(&camera(0.05), view, 2.0).unwrap();
        observe(
            &mut octree,
            keys(IVec3::splat(-4), IVec3::splat(2)),
            false,
            0.5,
        );
    }
    octree
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn gains_are_the_papers(seed: u64, dense: bool, near in prop::sample::select(vec![0.0, 0.37]), clipped: bool, range in 0.5f32..2.5) {
        let octree = seen(seed, if dense { [1, 30, 4] } else { [0, 200, 1] });
        let bounds = clipped.then(|| Aabb::new(Vec3::new(-0.8, -0.5, -0.9), Vec3::new(1.1, 1.3, 0.95)));
        let camera = camera(near);
        for gain in GAINS {
            let found = view_gain_with(Lanes::detect(), &octree, &views(), &camera, gain, 1, range, bounds, None).unwrap();
            for lanes in Lanes::available() {
                let again = view_gain_with(lanes, &octree, &views(), &camera, gain, 1, range, bounds, None).unwrap();
                prop_assert_eq!(&found, &again, "{:?}", lanes);
            }
            for (view, found) in views().iter().zip(found) {
                let expected = reference(&octree, view, &camera, gain, f64::from(range), bounds);
                prop_assert!((found - expected).abs() < 1e-5, "{} of {:?}: {} not {}", gain.name(), view, found, expected);
                prop_assert!((0.0..=1.0).contains(&found));
            }
        }
    }
}

/// A corridor of voxels along +x from the camera's; looking along +x from the middle of the first.
fn corridor(states: &str) -> Octree {
    let mut octree = empty();
    for (x, state) in states.chars().enumerate() {
        if state != 'u' {
            observe(&mut octree, [IVec3::new(x as i32, 0, 0)], state == 'o', 0.5);
        }
    }
    octree.with_view_history()
}

fn one(octree: &Octree, gain: Gain, view: &Pose) -> f64 {
    let pinhole = Camera::from_fov(1, 1, 0.01, 0.01, 0.0, 4.0).unwrap();
    view_gain_with(
        Lanes::detect(),
        octree,
        &[*view],
        &pinhole,
        gain,
        1,
        0.9,
        None,
        None,
    )
    .unwrap()[0]
}

#[test]
fn hand_computed_corridors() {
    let along_x = Pose::from_yaw_pitch(Vec3::splat(0.05), 0.0, 0.0);
    let mut octree = corridor("fffo");
    assert_eq!(one(&octree, Gain::ViewHistory, &along_x), 1.0, "never seen");
    let wide = Camera::from_fov(9, 9, 1.0, 1.0, 0.06, 4.0).unwrap();
    octree.record_view(&wide, &along_x, 4.0).unwrap();
    // Voxels 1 and 2 were seen with p = 0.4, voxel 3 with 0.7, voxel 0 not (nearer than `near`): sum C < 1 bounds
    // 1 / sum, and c / sum = 1 from the same direction.
    assert_eq!(one(&octree, Gain::ViewHistory, &along_x), 1.0);
    for _ in 0..30 {
        observe(&mut octree, (1..3).map(|x| IVec3::new(x, 0, 0)), false, 0.5);
        octree.record_view(&wide, &along_x, 4.0).unwrap();
    }
    // Free at the clamp p = 0.1192 with thirty sights and more.
    let c = |p: f64| 1.0 - h(p);
    let sights = [0.4f64, 0.4, 0.4, 0.4, 0.4]
        .iter()
        .scan(0.0, |l, p| {
            *l += (p / (1.0 - p)).ln();
            Some(1.0 / (1.0 + (-*l).exp()))
        })
        .map(|p| c(p.max(0.1192)));
    let sum: f64 = sights.sum::<f64>() + 26.0 * c(0.1192);
    let (free, occupied) = (c(0.1192) / sum, 1.0 / 31.0);
    let expected = (1.0 + 2.0 * free + occupied) / 4.0;
    let found = one(&octree, Gain::ViewHistory, &along_x);
    assert!((found - expected).abs() < 1e-4, "{found}, not {expected}");
    // From another direction (the other side) 1 / sum counts, which is more.
    let back = Pose::from_yaw_pitch(Vec3::new(0.25, 0.05, 0.05), std::f32::consts::PI, 0.0);
    let behind = one(&octree, Gain::ViewHistory, &back);
    let direction = 9;
    assert!(octree
        .view_history()
        .unwrap()
        .block(0, 0, direction)
        .is_none());
    assert_eq!(direction, 9 % ELEVATIONS);
    assert_eq!(
        behind, 1.0,
        "it looks on into unexplored space behind voxel 0"
    );

    let octree = corridor("fffuuouu");
    assert_eq!(
        one(&octree, Gain::ViewHistory, &along_x),
        1.0,
        "unexplored before the surface"
    );
    // BaseGain looks past what the map does not hold.
    let mean = (3.0 * h(0.4) + h(0.7)) / 4.0;
    for octree in [octree, corridor("fffouuu")] {
        assert!((one(&octree, Gain::RayEntropy, &along_x) - mean).abs() < 1e-5);
        assert!(
            (one(&octree, Gain::RayProbability, &along_x) - (3.0 * 0.8 + 0.6) / 4.0).abs() < 1e-5
        );
    }
}

#[test]
fn rays_by_angle() {
    let camera = Camera::from_fov(640, 480, 1.0, 0.8, 0.0, 4.0).unwrap();
    let step = std::f32::consts::PI / 400.0;
    let rays = directions(&camera, RaySpacing::AngleStep(step));
    let (columns, rows) = ((1.0 / step) as usize, (0.8 / step) as usize);
    assert_eq!(rays.len(), columns * rows);
    let angles: Vec<f32> = rays[..columns].iter().map(|d| (d.x / d.z).atan()).collect();
    assert!(angles.windows(2).all(|a| (a[1] - a[0] - step).abs() < 1e-5));
    assert!((angles[0] + angles[columns - 1]).abs() < 1e-5, "symmetric");
    for (step, text) in [
        (0.0, "angle_step"),
        (f32::NAN, "angle_step"),
        (1e-6, "rays a view"),
    ] {
        let octree = empty();
        let gain = view_gain_with(
            Lanes::Scalar,
            &octree,
            &views(),
            &camera,
            Gain::RayEntropy,
            RaySpacing::AngleStep(step),
            1.0,
            None,
            None,
        );
        assert!(gain.unwrap_err().to_string().contains(text));
    }
}

#[test]
fn the_history_must_be_kept() {
    let gain = view_gain_with(
        Lanes::Scalar,
        &empty(),
        &views(),
        &camera(0.0),
        Gain::ViewHistory,
        1,
        1.0,
        None,
        None,
    );
    assert!(gain.unwrap_err().to_string().contains("view history"));
}

/// Rays through edges and corners of voxels, and ranges that end on borders: the order of borders is in doubt there.
#[test]
fn ties_are_decided_alike() {
    let octree = seen(11, [1, 60, 2]);
    let turns = (0..8).flat_map(|i| [-0.615_479_7, 0.0, 0.3].map(|p| (i as f32 * PI / 4.0, p)));
    let views: Vec<Pose> = turns
        .flat_map(|(yaw, pitch)| {
            // A voxel's centre, a corner, and the middle of a border.
            [
                Vec3::splat(0.25),
                Vec3::splat(0.2),
                Vec3::new(0.2, 0.25, 0.25),
            ]
            .map(|at| Pose::from_yaw_pitch(at, yaw, pitch))
        })
        .collect();
    for (near, range) in [(0.0, 0.75), (0.35, 0.95), (0.25, 1.25)] {
        // With a middle column and a middle row.
        let camera = Camera::from_fov(33, 25, 1.03, 0.80, near, 4.0).unwrap();
        for gain in GAINS {
            let [exact, others @ ..] = &Lanes::available()[..] else {
                unreachable!()
            };
            let gains = |lanes: &Lanes| {
                view_gain_with(*lanes, &octree, &views, &camera, gain, 1, range, None, None)
                    .unwrap()
            };
            assert_eq!(*exact, Lanes::Scalar);
            let expected = gains(exact);
            for lanes in others {
                assert_eq!(gains(lanes), expected, "{lanes:?} {gain:?} {near} {range}");
            }
        }
    }
}

/// The nearest and the longest range at a border that the ray meets, as far as these numbers can say.
#[test]
fn ranges_at_borders_are_decided_alike() {
    let octree = seen(3, [0, 200, 1]);
    let at = Vec3::new(0.33, 0.21, 0.47);
    for i in 0..4000 {
        let view = Pose::from_yaw_pitch(at, i as f32 * 0.7, (i as f32 * 1.3).sin());
        let pinhole = |near| Camera::from_fov(1, 1, 0.01, 0.01, near, 4.0).unwrap();
        let d = directions(&pinhole(0.0), 1)[0];
        let d = super::super::rays::turned(&Mat3::from_quat(view.rotation), d);
        let start = octree.key(at).unwrap();
        let mut dda = Dda::new(octree.resolution(), start, at, Vec3::from_array(d));
        let entry = (0..3 + i % 5).map(|_| dda.advance()).last().unwrap();
        for (near, range) in [(0.0, entry), (f64::from(entry as f32), 2.0)] {
            let gains = |lanes| {
                let camera = pinhole(near);
                let view = [view];
                view_gain_with(
                    lanes,
                    &octree,
                    &view,
                    &camera,
                    Gain::RayProbability,
                    1,
                    range as f32,
                    None,
                    None,
                )
                .unwrap()
            };
            let expected = gains(Lanes::Scalar);
            for lanes in Lanes::available() {
                assert_eq!(gains(lanes), expected, "{lanes:?} {i} {near} {range}");
            }
        }
    }
}

/// Half of 0.04 is less as an f32: a camera at 0 lies beyond the lower border of its voxel, by 4.5e-10 m.
#[test]
fn a_camera_beyond_its_voxel_sees_alike() {
    let mut octree = Octree::new(0.04, SensorModel::default()).unwrap();
    let mut turn = 7u32;
    for key in keys(IVec3::splat(-40), IVec3::splat(6)) {
        turn = turn.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        for _ in 0..1 + (turn >> 30) {
            observe(&mut octree, [key], false, 0.5);
        }
    }
    let pinhole = Camera::from_fov(1, 1, 0.01, 0.01, 0.001, 4.0).unwrap();
    for trial in 0..300 {
        // The second border along -x and the first along +z are met at nearly the same place.
        let x = 0.72 + f64::from(trial) * 2e-4;
        let z = (1.0 - x * x - 1e-6).sqrt();
        let direction = Vec3::new(-x as f32, 1e-3, z as f32);
        let height = 0.04 - 4.5e-10 - z * 0.04 / x;
        let views: Vec<Pose> = (-40..40)
            .map(|i| Vec3::new(0.0, 0.02, (height + f64::from(i) * 1.5e-9) as f32))
            .map(|at| Pose::new(at, Quat::from_rotation_arc(Vec3::Z, direction.normalize())))
            .collect();
        let range = (0.04 / x * 1.3) as f32;
        let gains = |lanes| {
            let gain = Gain::RayProbability;
            view_gain_with(lanes, &octree, &views, &pinhole, gain, 1, range, None, None).unwrap()
        };
        let expected = gains(Lanes::Scalar);
        for lanes in Lanes::available() {
            assert_eq!(gains(lanes), expected, "{lanes:?}, {trial}");
        }
    }
}
