use super::*;
use crate::belief::testing::{empty, keys, observe, random, room, RESOLUTION};
use proptest::prelude::*;
use rand::SeedableRng;
use std::f32::consts::PI;

fn forward(view: &Pose) -> Vec3 {
    view.rotation * Vec3::Z
}

fn rng(seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed)
}

#[test]
fn six_directions_in_the_frame_of_the_heading() {
    // Heading +y: forward is +y, right is +x.
    let view = Pose::from_yaw_pitch(Vec3::new(1.0, 2.0, 3.0), PI / 2.0, 0.4);
    let moved = six_directions(&view, 0.5);
    let expected = [
        [0.0, 0.0, 0.5],
        [0.0, 0.0, -0.5],
        [0.0, 0.5, 0.0],
        [0.0, -0.5, 0.0],
        [0.5, 0.0, 0.0],
        [-0.5, 0.0, 0.0],
    ];
    for (m, e) in moved.iter().zip(expected) {
        assert!((m.translation - view.translation - Vec3::from_array(e)).length() < 1e-6);
        assert_eq!(m.rotation, view.rotation);
    }
}

#[test]
fn dome_looks_outward_from_its_anchor() {
    let anchor = Vec3::new(1.0, 2.0, 1.25);
    let space = ViewSpace::dome(14, 48, 0.6, -35f64.to_radians(), 60f64.to_radians()).unwrap();
    let views = space.views(&Pose::IDENTITY, anchor);
    assert_eq!(views.len(), 672);
    assert_eq!(space.count(), 672);
    for view in &views {
        let radius = view.translation - anchor;
        assert!((radius.length() - 0.6).abs() < 1e-5);
        assert!(forward(view).angle_between(radius) < 1e-3);
        assert!((view.rotation * Vec3::X).z.abs() < 1e-5, "level");
    }
    let pitch = |v: &Pose| forward(v).z.asin().to_degrees();
    assert!((pitch(&views[0]) + 35.0).abs() < 1e-3 && (pitch(&views[671]) - 60.0).abs() < 1e-3);
}

#[test]
fn neighbours_on_the_dome_overlap_by_four_fifths() {
    let space = ViewSpace::dome(14, 48, 0.6, -35f64.to_radians(), 60f64.to_radians()).unwrap();
    let views = space.views(&Pose::IDENTITY, Vec3::ZERO);
    for i in 0..views.len() {
        let neighbours = space.neighbours(i);
        assert_eq!(neighbours.len(), if (48..624).contains(&i) { 8 } else { 5 });
        for n in neighbours {
            assert!(space.neighbours(n).contains(&i), "neighbours are mutual");
            if n / 48 == i / 48 || n % 48 == i % 48 {
                // Angle between the axes as a share of the field of view along it (60 and 46 degrees).
                let angle = forward(&views[i])
                    .angle_between(forward(&views[n]))
                    .to_degrees();
                assert!(1.0 - angle / if n / 48 == i / 48 { 60.0 } else { 46.0 } >= 0.8);
            }
        }
    }
    assert!(space.neighbours(672).is_empty());
    assert_eq!(dome_neighbours(1, 2, 1, 0), [1]);
    assert!(dome_neighbours(1, 1, 1, 0).is_empty());
}

#[test]
fn neighbours_are_as_far_as_the_reach_says() {
    // By the book: headings apart the shorter way around, and pitches.
    let apart = |per_ring: usize, a: usize, b: usize| {
        let around = (a % per_ring).abs_diff(b % per_ring);
        around
            .min(per_ring - around)
            .max((a / per_ring).abs_diff(b / per_ring))
    };
    for (rings, per_ring) in [(1, 1), (1, 2), (2, 3), (3, 4), (5, 9), (21, 32)] {
        for reach in 1..5 {
            for index in 0..rings * per_ring {
                let expected: Vec<usize> = (0..rings * per_ring)
                    .filter(|n| (1..=reach).contains(&apart(per_ring, index, *n)))
                    .collect();
                assert_eq!(dome_neighbours(rings, per_ring, reach, index), expected);
            }
        }
    }
    let dome = || ViewSpace::dome(21, 32, 0.6, -1.5, 1.5).unwrap();
    assert_eq!(dome().neighbours(330).len(), 8);
    assert_eq!(dome().with_reach(2).unwrap().neighbours(330).len(), 24);
    for steps in [0, 65, usize::MAX] {
        let error = dome().with_reach(steps).unwrap_err().to_string();
        assert!(error.contains("reach") && error.contains(&steps.to_string()));
    }
}

#[test]
fn ring_looks_at_the_centre() {
    let center = Vec3::new(0.5, -0.5, 0.8);
    let pitches = vec![15f64.to_radians(), 35f64.to_radians(), 55f64.to_radians()];
    let views = ViewSpace::ring(10, 0.6, pitches)
        .unwrap()
        .views(&Pose::IDENTITY, center);
    assert_eq!(views.len(), 30);
    for (i, view) in views.iter().enumerate() {
        let away = view.translation - center;
        assert!((away.length() - 0.6).abs() < 1e-5);
        assert!(forward(view).angle_between(-away) < 1e-3);
        assert!((away.z / 0.6 - [15f32, 35.0, 55.0][i / 10].to_radians().sin()).abs() < 1e-5);
    }
}

#[test]
fn view_spaces_reject_bad_values() {
    assert!(ViewSpace::six_directions(0.0).is_err());
    assert!(ViewSpace::six_directions(f64::NAN).is_err());
    assert!(ViewSpace::dome(0, 48, 0.6, -0.5, 0.5).is_err());
    assert!(ViewSpace::dome(usize::MAX, 48, 0.6, -0.5, 0.5).is_err());
    assert!(ViewSpace::dome(3, 48, -0.6, -0.5, 0.5).is_err());
    assert!(ViewSpace::dome(3, 48, 0.6, 0.5, -0.5).is_err());
    assert!(ViewSpace::dome(3, 48, 0.6, f64::NAN, 0.5).is_err());
    assert!(ViewSpace::ring(10, 0.6, vec![]).is_err());
    assert!(ViewSpace::ring(10, 0.6, vec![2.0]).is_err());
    assert!(ViewSpace::ring(10, f64::INFINITY, vec![0.3]).is_err());
}

#[test]
fn admissible_is_inside_and_free_of_the_occupied() {
    let octree = room(IVec3::splat(20));
    let bounds = Aabb::new(Vec3::splat(0.0), Vec3::splat(2.0));
    let at = |x: f32| {
        admissible(
            &octree,
            &bounds,
            &Pose::new(Vec3::new(x, 1.0, 1.0), glam::Quat::IDENTITY),
            0.25,
        )
    };
    assert!(at(1.0) && at(0.26) && at(1.74));
    assert!(!at(0.24) && !at(1.76), "too near to the wall");
    assert!(!at(-0.5) && !at(f32::NAN), "outside");
    // Unknown space does not forbid.
    assert!(admissible(
        &empty(),
        &bounds,
        &Pose::new(Vec3::ONE, glam::Quat::IDENTITY),
        0.25
    ));
}

#[test]
fn a_sphere_in_contact_may_go_away_but_not_closer() {
    let octree = room(IVec3::splat(20));
    let clear = |a: f32, b: f32| {
        segment_is_clear(
            &octree,
            Vec3::new(a, 1.05, 1.05),
            Vec3::new(b, 1.05, 1.05),
            0.3,
            true,
        )
    };
    assert!(clear(0.2, 0.8) && clear(0.2, 1.69));
    assert!(
        !clear(0.2, 0.15) && !clear(0.2, 1.75),
        "not closer, nor to the other wall"
    );
    assert!(clear(0.0, 0.5), "from the wall's face");
    assert!(!clear(0.0, -0.5), "through the wall");
    assert!(
        clear(-0.02, 0.5) && !clear(-0.08, 0.5),
        "from within, only the short way out"
    );
    assert!(clear(0.31, 1.69) && !clear(0.31, 0.29));
}

#[test]
fn unknown_space_blocks_only_where_asked() {
    let mut octree = empty();
    observe(
        &mut octree,
        keys(IVec3::ZERO, IVec3::new(20, 5, 5)),
        false,
        1.0,
    );
    let (a, b) = (Vec3::new(0.25, 0.25, 0.25), Vec3::new(1.75, 0.25, 0.25));
    assert!(segment_is_clear(&octree, a, b, 0.2, false));
    assert!(!segment_is_clear(&octree, a, b + Vec3::X * 0.2, 0.2, false));
    assert!(segment_is_clear(&octree, a, b + Vec3::X * 5.0, 0.2, true));
    assert!(
        !segment_is_clear(&octree, a, Vec3::splat(1e7), 0.2, true),
        "outside the key space"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn clear_segments_equal_dense_sampling(
        seed in 0u64..500,
        a in [-0.7f32..0.7, -0.7f32..0.7, -0.7f32..0.7],
        b in [-0.7f32..0.7, -0.7f32..0.7, -0.7f32..0.7],
        radius in 0.01f32..0.3,
        unknown_is_free in any::<bool>(),
    ) {
        let octree = random(seed, 7, if unknown_is_free { [10, 300, 1] } else { [1, 300, 1] });
        let (a, b) = (Vec3::from_array(a), Vec3::from_array(b));
        let blocks = |k: IVec3| match octree.state(k) {
            State::Occupied => true,
            State::Unknown => !unknown_is_free,
            State::Free => false,
        };
        let gap = |p: Vec3, k: IVec3| {
            let low = k.as_vec3() * RESOLUTION as f32;
            p.distance(p.clamp(low, low + RESOLUTION as f32))
        };
        let all: Vec<IVec3> = keys(IVec3::splat(-12), IVec3::splat(12)).filter(|k| blocks(*k)).collect();
        // The margin by which the sampled sphere is clear; contact at the start is another test's concern.
        if all.iter().any(|k| gap(a, *k) <= radius) {
            return Ok(());
        }
        let nearest = (0..=400)
            .flat_map(|i| all.iter().map(move |k| (a.lerp(b, i as f32 / 400.0), *k)))
            .map(|(p, k)| gap(p, k))
            .fold(f32::INFINITY, f32::min);
        // Samples are up to 3 mm from the nearest point.
        if nearest < radius - 1e-4 {
            prop_assert!(!segment_is_clear(&octree, a, b, radius, unknown_is_free));
        } else if nearest > radius + 4e-3 {
            prop_assert!(segment_is_clear(&octree, a, b, radius, unknown_is_free));
        }
    }
}

#[test]
fn free_space_is_sampled_uniformly_and_reproducibly() {
    let octree = room(IVec3::new(20, 10, 12));
    let views = uniform_in_free_space(&octree, 4000, &mut rng(1), 0.2);
    assert_eq!(views.len(), 4000);
    assert_eq!(
        views,
        uniform_in_free_space(&octree, 4000, &mut rng(1), 0.2)
    );
    for view in &views {
        let p = view.translation;
        assert!(p.cmpge(Vec3::splat(0.2)).all() && p.cmple(Vec3::new(1.8, 0.8, 1.0)).all());
    }
    let mean: Vec3 = views.iter().map(|v| v.translation).sum::<Vec3>() / 4000.0;
    // Standard error of the mean of 1.6 m / sqrt(12 * 4000): 7 mm.
    assert!(
        (mean - Vec3::new(1.0, 0.5, 0.6)).abs().max_element() < 0.03,
        "{mean}"
    );
    assert!(uniform_in_free_space(&empty(), 5, &mut rng(1), 0.2).is_empty());
    assert!(
        uniform_in_free_space(&octree, 5, &mut rng(1), 2.0).is_empty(),
        "no room"
    );
}
