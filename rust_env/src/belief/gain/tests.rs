use super::*;
use crate::belief::octree::{probability, State};
use crate::belief::ray_walk::Dda;
use crate::belief::testing::{empty, keys, observe, random, room, RESOLUTION};
use crate::geometry::{IVec3, Quat};
use proptest::prelude::*;
use std::collections::HashSet;

fn camera(width: usize, height: usize) -> Camera {
    Camera::from_fov(width, height, 1.03, 0.80, 0.0, 4.0).unwrap()
}

/// One ray along the optical axis.
fn pinhole() -> Camera {
    Camera::from_fov(1, 1, 0.01, 0.01, 0.0, 4.0).unwrap()
}

/// Looking along +x from the middle of voxel (0, 0, 0).
fn along_x() -> Pose {
    Pose::from_yaw_pitch(Vec3::splat(0.05), 0.0, 0.0)
}

fn one(
    octree: &Octree,
    view: &Pose,
    camera: &Camera,
    gain: Gain,
    range: f32,
    bounds: Option<Aabb>,
) -> f64 {
    view_gain(octree, &[*view], camera, gain, 1, range, bounds, None).unwrap()[0]
}

/// A corridor of voxels along +x from the camera's, written as letters: f(ree), o(ccupied), u(nknown).
fn corridor(states: &str) -> Octree {
    let mut octree = empty();
    for (x, state) in states.chars().enumerate() {
        if state != 'u' {
            observe(&mut octree, [IVec3::new(x as i32, 0, 0)], state == 'o', 0.5);
        }
    }
    octree
}

fn h(p: f64) -> f64 {
    -p * p.log2() - (1.0 - p) * (1.0 - p).log2()
}

#[test]
fn names_are_unique_and_parse_back() {
    let names: HashSet<_> = NAMES.iter().collect();
    assert_eq!(names.len(), Gain::ALL.len());
    for gain in Gain::ALL {
        assert_eq!(Gain::parse(gain.name()).unwrap(), gain);
    }
    assert!(Gain::parse("entropie")
        .unwrap_err()
        .to_string()
        .contains("entropie"));
}

#[test]
fn hand_computed_corridors() {
    let gain =
        |states: &str, gain: Gain| one(&corridor(states), &along_x(), &pinhole(), gain, 0.9, None);
    // Entered at 0, 0.05, 0.15, ..., 0.85: ten voxels lie within 0.9 m.
    assert_eq!(gain("uuuuuuuuuuuu", Gain::UnknownCount), 10.0);
    assert_eq!(gain("fffuuouu", Gain::UnknownCount), 2.0);
    assert_eq!(gain("fffouu", Gain::UnknownCount), 0.0);
    let (free, occupied) = (h(0.4), h(0.7));
    assert!((gain("fffuuouu", Gain::Entropy) - (3.0 * free + 2.0 + occupied)).abs() < 1e-5);
    assert!(
        (gain("fffuuouu", Gain::AverageEntropy) - (3.0 * free + 2.0 + occupied) / 6.0).abs() < 1e-5
    );
    assert_eq!(
        gain("fffuuuuuuuuu", Gain::AverageEntropy),
        0.0,
        "no ray hits"
    );
    // Visibility: 0.6 a free voxel, 0.5 an unknown one.
    let v = 0.6f64.powi(2);
    assert!((gain("ffuuo", Gain::UnobservedVoxel) - (v + v * 0.5)).abs() < 1e-5);
    let aware = free + 0.6 * free + v + v * 0.5 + v * 0.25 * occupied;
    assert!((gain("ffuuo", Gain::OcclusionAware) - aware).abs() < 1e-5);
    assert!((gain("ffuuo", Gain::RearSideEntropy) - (v + v * 0.5)).abs() < 1e-5);
    assert!(
        (gain("uffuo", Gain::RearSideEntropy) - 0.5 * v).abs() < 1e-5,
        "only the run before the surface"
    );
    assert_eq!(gain("ffuuuuuuuuuu", Gain::RearSideEntropy), 0.0);
    assert_eq!(gain("ffufo", Gain::RearSideEntropy), 0.0);
    assert_eq!(gain("ffuuo", Gain::RearSideVoxel), 1.0);
    assert_eq!(gain("ffufo", Gain::RearSideVoxel), 0.0);
    // Unknown voxels at 2 and 1 voxels from the occupied one: 6 - 2 + 6 - 1.
    assert!((gain("ffuuo", Gain::ProximityCount) - 9.0).abs() < 1e-6);
    assert_eq!(gain("uuuuuuuuuuuu", Gain::ProximityCount), 0.0);
    // All rays end at surface (f(1, .2) = 0) or all at the border of unknown space.
    assert_eq!(gain("ffo", Gain::AreaFactor), 0.0);
    assert_eq!(gain("ffu", Gain::AreaFactor), 0.0);
}

#[test]
fn hand_computed_uncertainty() {
    let model = UncertaintyModel::of_camera(&pinhole());
    let gain = |states: &str| {
        one(
            &corridor(states),
            &along_x(),
            &pinhole(),
            Gain::Uncertainty,
            0.9,
            None,
        )
    };
    // The camera's 0.3 degrees magnify rounding: 1e-4.
    // On the axis: u = u_d / 2. The voxel's centre is k * 0.1 m away.
    let new = |k: f32| f64::from(model.of(Vec3::Z * k * 0.1));
    assert!((gain("ffffuuuuuu") - (1.0 - new(4.0))).abs() < 1e-4);
    assert!((gain("fffffffoou") - (0.5 - new(7.0))).abs() < 1e-4);
    assert_eq!(gain("ffffffffffff"), 0.0);
    // Seen better before than from here: 0.
    let mut octree = corridor("fff");
    observe(&mut octree, [IVec3::new(3, 0, 0)], true, 0.01);
    assert_eq!(
        one(
            &octree,
            &along_x(),
            &pinhole(),
            Gain::Uncertainty,
            0.9,
            None
        ),
        0.0
    );
    // Nearer than the camera can measure.
    let near = Camera::from_fov(1, 1, 0.01, 0.01, 0.5, 4.0).unwrap();
    assert_eq!(
        one(
            &corridor("ffffu"),
            &along_x(),
            &near,
            Gain::Uncertainty,
            0.9,
            None
        ),
        0.0
    );
    assert!(
        one(
            &corridor("ffffffu"),
            &along_x(),
            &near,
            Gain::Uncertainty,
            0.9,
            None
        ) > 0.5
    );
}

#[test]
fn several_rays_count_a_voxel_once() {
    // All 64 rays lie within one row of voxels.
    let narrow = Camera::from_fov(8, 8, 0.02, 0.02, 0.0, 4.0).unwrap();
    let octree = corridor("ffffuuuuuuuu");
    assert_eq!(
        one(&octree, &along_x(), &narrow, Gain::UnknownCount, 0.9, None),
        6.0
    );
    let uncertainty = one(&octree, &along_x(), &narrow, Gain::Uncertainty, 0.9, None);
    assert!(uncertainty < 1.0);
    let sum = one(
        &octree,
        &along_x(),
        &narrow,
        Gain::UnobservedVoxel,
        0.9,
        None,
    );
    let single = one(
        &octree,
        &along_x(),
        &pinhole(),
        Gain::UnobservedVoxel,
        0.9,
        None,
    );
    assert!(
        (sum - 64.0 * single).abs() < 1e-4,
        "sums over rays count it for each"
    );
}

#[test]
fn voxels_outside_the_bounds_count_nothing() {
    let bounds = Aabb::new(Vec3::ZERO, Vec3::new(0.55, 0.05, 0.05));
    let gain = |octree: &Octree, view: &Pose| {
        one(
            octree,
            view,
            &pinhole(),
            Gain::UnknownCount,
            2.0,
            Some(bounds),
        )
    };
    assert_eq!(gain(&empty(), &along_x()), 6.0);
    // From outside the bounds, through free, unknown or occupied space there.
    let mut back = along_x();
    back.translation.x = -0.45;
    assert_eq!(gain(&empty(), &back), 6.0);
    let mut octree = empty();
    observe(&mut octree, [IVec3::new(-2, 0, 0)], true, 0.5);
    assert_eq!(
        gain(&octree, &back),
        0.0,
        "an occupied voxel blocks wherever it is"
    );
}

#[test]
fn a_fully_known_room_has_no_unknown_voxels_to_gain() {
    let octree = room(IVec3::new(30, 25, 20));
    let view = Pose::from_yaw_pitch(Vec3::new(1.0, 1.2, 1.0), 0.7, -0.2);
    for gain in [
        Gain::UnknownCount,
        Gain::UnobservedVoxel,
        Gain::RearSideVoxel,
        Gain::RearSideEntropy,
        Gain::ProximityCount,
    ] {
        assert_eq!(
            one(&octree, &view, &camera(24, 18), gain, 5.0, None),
            0.0,
            "{}",
            gain.name()
        );
    }
    assert!(one(&octree, &view, &camera(24, 18), Gain::Entropy, 5.0, None) > 100.0);
}

#[test]
fn stride_keeps_the_field_of_view_and_odd_strides_pick_pixels() {
    let camera = camera(48, 36);
    let all = directions(&camera, 1);
    assert_eq!(all.len(), 48 * 36);
    let third = directions(&camera, 3);
    assert_eq!(third.len(), 16 * 12);
    assert_eq!(third[0], all[48 + 1]);
    assert_eq!(
        directions(&camera, 10).len(),
        5 * 4,
        "the last block is a part of one"
    );
    assert_eq!(directions(&camera, usize::MAX).len(), 1);
    assert!((directions(&camera, usize::MAX)[0] - Vec3::Z).length() < 1e-6);
}

#[test]
fn bad_arguments_are_errors_that_name_the_value() {
    let (octree, camera, views) = (empty(), camera(4, 3), [along_x()]);
    let gain = |stride, range| {
        view_gain(
            &octree,
            &views,
            &camera,
            Gain::Entropy,
            stride,
            range,
            None,
            None,
        )
    };
    assert!(gain(0, 4.0).unwrap_err().to_string().contains("stride"));
    for range in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(gain(1, range)
            .unwrap_err()
            .to_string()
            .contains("max_range"));
    }
    assert!(gain(1, 3000.0).unwrap_err().to_string().contains("voxels"));
    let far = Pose::new(Vec3::splat(1e6), Quat::IDENTITY);
    let gains = view_gain(
        &octree,
        &[far, along_x()],
        &camera,
        Gain::UnknownCount,
        1,
        1.0,
        None,
        None,
    )
    .unwrap();
    assert!(gains[0] == 0.0 && gains[1] > 0.0);
    assert!(
        view_gain(&octree, &[], &camera, Gain::Entropy, 1, 1.0, None, None)
            .unwrap()
            .is_empty()
    );
}

/// All metrics by their definitions, voxel by voxel from the map: no window, no marks but a set.
fn brute_force(
    octree: &Octree,
    view: &Pose,
    camera: &Camera,
    gain: Gain,
    stride: usize,
    range: f32,
    bounds: Option<Aabb>,
) -> f64 {
    let bounds = bounds.map(|b| KeyBox::touching(octree, &b));
    let model = UncertaintyModel::of_camera(camera);
    let p = |k: IVec3| {
        octree
            .log_odds(k)
            .map_or(0.5, |l| f64::from(probability(l) as f32))
    };
    let occupied =
        |k: IVec3| octree.state(k) == State::Occupied && bounds.is_none_or(|b| b.contains(k));
    let mut seen = HashSet::new();
    let (mut sum, mut average, mut ends) = (0.0, (0.0, 0u32), [0u32; 3]);
    let all = directions(camera, stride);
    let rotation = crate::geometry::Mat3::from_quat(view.rotation);
    for direction in &all {
        let Some(start) = octree.key(view.translation) else {
            return 0.0;
        };
        let mut dda = Dda::new(
            RESOLUTION,
            start,
            view.translation,
            Vec3::from_array(rays::turned(&rotation, *direction)),
        );
        let mut ray = Vec::new();
        loop {
            let state = octree.state(dda.key);
            if bounds.is_none_or(|b| b.contains(dda.key)) {
                ray.push((dda.key, state));
            }
            if state == State::Occupied || dda.advance() > f64::from(range) {
                break;
            }
        }
        let hit = ray.last().is_some_and(|r| r.1 == State::Occupied);
        let first = ray.iter().position(|r| r.1 != State::Free);
        let mut visibility = 1.0;
        let mut run = 0.0;
        for (i, (key, state)) in ray.iter().enumerate() {
            let fresh = match gain {
                Gain::Uncertainty => Some(i) == first && seen.insert(*key),
                _ => seen.insert(*key),
            };
            let entropy = h(p(*key));
            match gain {
                Gain::Uncertainty if fresh => {
                    let new = model.of(view.inverse().point(octree.center(*key)));
                    let old = if *state == State::Occupied {
                        octree.uncertainty(*key)
                    } else {
                        1.0
                    };
                    sum += f64::from((old - new).max(0.0));
                }
                Gain::UnknownCount if fresh && *state == State::Unknown => sum += 1.0,
                Gain::Entropy if fresh => sum += entropy,
                Gain::AverageEntropy if hit => average = (average.0 + entropy, average.1 + 1),
                Gain::OcclusionAware => sum += visibility * entropy,
                Gain::UnobservedVoxel if *state == State::Unknown => sum += visibility * entropy,
                Gain::RearSideVoxel if hit && i + 1 == ray.len() => {
                    sum += f64::from(u8::from(i > 0 && ray[i - 1].1 == State::Unknown));
                }
                Gain::RearSideEntropy => {
                    run = match state {
                        State::Unknown => run + visibility * entropy,
                        State::Free => 0.0,
                        State::Occupied => run,
                    }
                }
                Gain::ProximityCount if *state == State::Unknown => {
                    let near = keys(IVec3::splat(-REACH), IVec3::splat(REACH + 1))
                        .filter(|d| d.length_squared() <= REACH * REACH && occupied(*key + *d))
                        .map(|d| d.length_squared())
                        .min();
                    sum += near.map_or(0.0, |d| f64::from(REACH + 1) - f64::from(d).sqrt());
                }
                _ => {}
            }
            visibility *= 1.0 - p(*key);
        }
        if gain == Gain::RearSideEntropy && hit {
            sum += run;
        }
        ends[match first.map(|i| (i, ray[i].1)) {
            Some((_, State::Occupied)) => 0,
            Some((i, _)) if i > 0 => 1,
            _ => 2,
        }] += 1;
    }
    match gain {
        Gain::AverageEntropy => average.0 / f64::from(average.1.max(1)),
        Gain::AreaFactor => {
            // The papers' polynomials.
            let f = |x: f64, a: f64| {
                let b = (a - 1.0).powi(3);
                if x <= a {
                    -2.0 / a.powi(3) * x.powi(3) + 3.0 / a.powi(2) * x.powi(2)
                } else {
                    (-2.0 * x.powi(3) + 3.0 * (a + 1.0) * x.powi(2) - 6.0 * a * x + 3.0 * a - 1.0)
                        / b
                }
            };
            let share = |n: u32| f64::from(n) / all.len() as f64;
            f(share(ends[0]), AREA_FACTOR_OCCUPIED) + f(share(ends[1]), AREA_FACTOR_OCCLUDED)
        }
        _ => sum,
    }
}

fn view(v: [f32; 5]) -> Pose {
    Pose::from_yaw_pitch(Vec3::new(v[0], v[1], v[2]), v[3], v[4])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_metric_equals_its_definition(
        seed in 0u64..1000,
        weights in prop::sample::select(vec![[2, 5, 1], [1, 8, 1], [8, 1, 1], [0, 30, 1], [10, 40, 1]]),
        a in [-0.9f32..0.9, -0.9f32..0.9, -0.9f32..0.9, -3.2f32..3.2, -1.5f32..1.5],
        b in [-3.0f32..3.0, -3.0f32..3.0, -3.0f32..3.0, -3.2f32..3.2, -1.5f32..1.5],
        stride in 1usize..4,
        range in 0.2f32..2.5,
        bounded in any::<bool>(),
    ) {
        let octree = random(seed, 10, weights);
        let camera = camera(11, 7);
        let bounds = bounded.then(|| Aabb::new(Vec3::new(-0.7, -0.83, -0.5), Vec3::new(0.8, 1.2, 0.55)));
        let views = [view(a), view(b)];
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        // Means along rays have their reference in `ray_average`.
        for gain in Gain::ALL.into_iter().filter(|g| g.utility().is_none()) {
            let got = view_gain(&octree, &views, &camera, gain, stride, range, bounds, None).unwrap();
            for (view, got) in views.iter().zip(&got) {
                let expected = brute_force(&octree, view, &camera, gain, stride, range, bounds);
                prop_assert!((got - expected).abs() <= 2e-5 * (1.0 + expected.abs()), "{}: {} != {}", gain.name(), got, expected);
            }
            for lanes in Lanes::available() {
                let same = view_gain_with(lanes, &octree, &views, &camera, gain, stride, range, bounds, None).unwrap();
                prop_assert_eq!(&got, &same, "{:?}", lanes);
            }
            // Bit for bit: in a pool, one by one, and in another order.
            prop_assert_eq!(&got, &view_gain(&octree, &views, &camera, gain, stride, range, bounds, Some(&pool)).unwrap());
            let back = view_gain(&octree, &[views[1], views[0]], &camera, gain, stride, range, bounds, None).unwrap();
            prop_assert_eq!(&got, &vec![back[1], back[0]]);
            prop_assert_eq!(got[0], view_gain(&octree, &views[..1], &camera, gain, stride, range, bounds, None).unwrap()[0]);
        }
    }
}

/// More rays than are listed at a time.
#[test]
fn very_many_rays_are_the_sum_of_their_parts() {
    let octree = random(5, 12, [3, 9, 1]);
    let (camera, range) = (camera(310, 260), 1.6);
    for gain in [Gain::UnknownCount, Gain::Entropy, Gain::AverageEntropy] {
        let expected = brute_force(&octree, &along_x(), &camera, gain, 1, range, None);
        assert!(expected > 0.0);
        for lanes in Lanes::available() {
            let view = [along_x()];
            let got =
                view_gain_with(lanes, &octree, &view, &camera, gain, 1, range, None, None).unwrap();
            assert!(
                (got[0] - expected).abs() <= 2e-5 * expected,
                "{} {lanes:?}: {} != {expected}",
                gain.name(),
                got[0]
            );
        }
    }
}

#[test]
fn window_holds_the_states_of_the_map() {
    let octree = random(3, 10, [1, 2, 1]);
    let region = KeyBox {
        min: IVec3::new(-13, -5, -9),
        max: IVec3::new(6, 12, 11),
    };
    let layers = Layers {
        entropy: true,
        probability: true,
        distance: false,
    };
    for layers in [layers, Layers::default()] {
        let window = Window::new(&octree, region, None, layers).unwrap();
        for key in keys(region.min - 1, region.max + 1) {
            let index = window.index(key);
            assert_eq!(window.key(index), key);
            let expected = match octree.state(key) {
                _ if !region.contains(key) => WALL,
                State::Unknown => UNKNOWN,
                State::Free => FREE,
                State::Occupied => OCCUPIED,
            };
            assert_eq!(window.state[index], expected, "{key}");
            if layers.entropy && region.contains(key) {
                let p = octree.log_odds(key).map_or(0.5, probability);
                assert!((f64::from(window.probability[index]) - p).abs() < 1e-6);
                assert!((f64::from(window.entropy[index]) / UNIT - h(p)).abs() < 1e-5);
            }
        }
    }
}
