use super::sectors::Sectors;
use super::*;
use crate::belief::nbvmap;
use crate::belief::octree::voxel_in_brick;
use crate::belief::testing::{empty, keys, observe, random, room};
use proptest::prelude::*;
use std::collections::HashMap;
use std::f64::consts::PI;

fn camera() -> Camera {
    Camera::from_fov(64, 48, 1.03, 0.80, 0.3, 2.5).unwrap()
}

/// Section III-A, to the letter: floor(phi / delta), floor(theta / delta).
fn by_the_book(d: [f64; 3]) -> usize {
    let phi = d[1].atan2(d[0]).rem_euclid(2.0 * PI);
    let theta = d[0].hypot(d[1]).atan2(d[2]);
    let bin = |angle: f64, count: usize| ((angle / (PI / 18.0)) as usize).min(count - 1);
    bin(phi, AZIMUTHS) * ELEVATIONS + bin(theta, ELEVATIONS)
}

/// How near an angle is to a border between directions, radians.
fn near_border(d: [f64; 3]) -> bool {
    let near = |angle: f64| {
        let part = angle / (PI / 18.0);
        (part - part.round()).abs() < 1e-4
    };
    near(d[1].atan2(d[0]).rem_euclid(2.0 * PI)) || near(d[0].hypot(d[1]).atan2(d[2]))
}

proptest! {
    #[test]
    fn directions_are_the_papers(x in -3f32..3.0, y in -3f32..3.0, z in -3f32..3.0) {
        let d = [x, y, z].map(f64::from);
        prop_assume!(!near_border(d));
        let sectors = Sectors::new(Vec3::ZERO);
        prop_assert_eq!(sectors.direction(-Vec3::new(x, y, z)), by_the_book(d));
    }

    #[test]
    fn a_layer_is_split_as_its_voxels_are(
        x in -2f32..2.0, y in -2f32..2.0, z in -2f32..2.0, resolution in 0.01f32..0.2, voxels: u64
    ) {
        let sectors = Sectors::new(Vec3::new(0.1, -0.2, 0.3));
        let corner = Vec3::new(x, y, z);
        // As for a brick whose layer this is, whichever of its layers.
        for layer in [0, 7] {
            let first = corner - Vec3::Z * (layer as f32 * resolution);
            let column = sectors.column(first, resolution, 4.0 * resolution * 3f32.sqrt());
            let mut found = [usize::MAX; LAYER];
            for (direction, part) in sectors.split(&column, corner.z, voxels).iter() {
                for (i, found) in found.iter_mut().enumerate().filter(|(i, _)| part >> i & 1 == 1) {
                    assert_eq!(*found, usize::MAX, "voxel {i} twice");
                    *found = direction;
                }
            }
            for (i, found) in found.iter().enumerate() {
                let offset = Vec3::new((i & 7) as f32, (i >> 3) as f32, 0.0) * resolution;
                let expected = sectors.direction(corner + offset);
                let expected = if voxels >> i & 1 == 1 { expected } else { usize::MAX };
                prop_assert_eq!(*found, expected, "voxel {}", i);
            }
        }
    }
}

#[test]
fn confidence_is_one_minus_entropy() {
    for p in [0.5f64, 0.6, 0.7, 0.1192, 0.971, 0.9999] {
        let log_odds = (p / (1.0 - p)).ln() as f32;
        let expected = 1.0 + p * p.log2() + (1.0 - p) * (1.0 - p).log2();
        let found = f64::from(confidence(log_odds)) / f64::from(UNIT);
        assert!(
            (found - expected).abs() < 3e-6,
            "c({p}) = {found}, not {expected}"
        );
    }
    assert_eq!(confidence(0.0), 0);
}

type Book = HashMap<(IVec3, usize), (f32, u64)>;

/// Eq. 1 and 2 voxel by voxel over the whole map. Voxels on an edge of the frustum or between directions are left out.
fn write_down(
    book: &mut Book,
    octree: &Octree,
    camera: &Camera,
    view: &Pose,
    range: f32,
) -> Vec<IVec3> {
    let mut doubtful = Vec::new();
    for state in [
        super::super::octree::State::Free,
        super::super::octree::State::Occupied,
    ] {
        for key in octree.keys(state) {
            let p = octree.center(key);
            let q = view.inverse().point(p);
            let (u, v) = (
                camera.fx * q.x / q.z + camera.cx,
                camera.fy * q.y / q.z + camera.cy,
            );
            let (w, h) = (camera.width as f32, camera.height as f32);
            let distance = q.length();
            let far = camera.far.min(range);
            let edge = [u, u - w, v, v - h].iter().any(|e| e.abs() < 0.01)
                || (distance - camera.near).abs() < 1e-4
                || (distance - far).abs() < 1e-4;
            let d = (view.translation - p).to_array().map(f64::from);
            if edge || near_border(d) {
                doubtful.push(key);
                continue;
            }
            let sees = q.z > 0.0 && u > 0.0 && u < w && v > 0.0 && v < h;
            if sees && distance >= camera.near && distance <= far {
                let log_odds = octree.log_odds(key).unwrap();
                let entry = book.entry((key, by_the_book(d))).or_default();
                entry.0 = log_odds;
                entry.1 += u64::from(confidence(log_odds));
            }
        }
    }
    doubtful
}

fn views() -> Vec<Pose> {
    [
        ([0.33, 0.21, 0.47], 0.3, 0.1),
        ([0.9, 0.8, 0.52], 2.3, -0.4),
        ([0.33, 0.21, 0.47], 0.35, 0.1),
        ([-0.4, 0.3, 0.1], 4.0, 1.2),
    ]
    .map(|(t, yaw, pitch)| Pose::from_yaw_pitch(Vec3::from_array(t), yaw, pitch))
    .to_vec()
}

#[test]
fn the_layer_holds_what_the_equations_say() {
    let mut octree = random(3, 12, [1, 3, 1]).with_view_history();
    let (camera, range) = (camera(), 2.2);
    let mut book = Book::new();
    let mut doubtful = Vec::new();
    for (i, view) in views().iter().enumerate() {
        // The map changes between the views.
        observe(
            &mut octree,
            keys(IVec3::splat(-3), IVec3::splat(3 + i as i32)),
            i % 2 == 0,
            0.5,
        );
        octree.record_view(&camera, view, range).unwrap();
        doubtful.extend(write_down(&mut book, &octree, &camera, view, range));
    }
    assert!(book.len() > 500, "{}", book.len());
    let history = octree.view_history().unwrap();
    let mut found = Book::new();
    for number in 0..octree.bricks().len() {
        for z in 0..8 {
            let mut sums = [0u64; LAYER];
            for (direction, sight, block) in history.directions(number, z) {
                for i in (0..LAYER).filter(|i| sight.seen >> i & 1 == 1) {
                    let key = octree.brick_coordinates(number) * 8
                        + IVec3::new(i as i32 & 7, i as i32 >> 3, z as i32);
                    let value = (block.log_odds[i], u64::from(block.confidence[i]));
                    assert!(found.insert((key, direction), value).is_none());
                    sums[i] += value.1;
                }
            }
            let total = history.total(number, z);
            assert_eq!(
                sums,
                total.map_or([0; LAYER], |t| t.confidence.map(u64::from))
            );
        }
    }
    for key in doubtful {
        book.retain(|(k, _), _| *k != key);
        found.retain(|(k, _), _| *k != key);
    }
    assert_eq!(found, book);
}

#[test]
fn what_is_forgotten_was_never_seen() {
    let mut octree = room(IVec3::splat(12)).with_view_history();
    let view = Pose::from_yaw_pitch(Vec3::splat(0.6), 0.4, 0.0);
    octree.record_view(&camera(), &view, 2.0).unwrap();
    let mut fresh = octree.clone();
    let brick = octree.brick_coordinates(0);
    octree.forget(brick, &[u64::MAX; 8]);
    let history = octree.view_history().unwrap();
    for z in 0..8 {
        assert!(history
            .total(0, z)
            .is_none_or(|t| t.seen == 0 && t.confidence == [0; LAYER]));
        assert!(history
            .directions(0, z)
            .all(|(_, s, b)| s.seen == 0 && s.confident == 0 && b.confidence == [0; LAYER]));
    }
    fresh.clear();
    assert!(fresh.view_history().unwrap().total(0, 0).is_none());
}

#[test]
fn a_file_holds_the_history() {
    let mut octree = random(5, 12, [1, 3, 1]).with_view_history();
    for view in views() {
        octree.record_view(&camera(), &view, 2.2).unwrap();
    }
    octree.forget(octree.brick_coordinates(0), &[u64::MAX; 8]);
    let bytes = nbvmap::serialise(&octree);
    let read = nbvmap::parse(&bytes, Some(&octree)).unwrap();
    assert!(nbvmap::serialise(&read) == bytes);
    for number in 0..octree.bricks().len() {
        for z in 0..8 {
            let (a, b) = [&octree, &read].map(|o| o.view_history().unwrap()).into();
            let shown = |h: &ViewHistory| {
                h.total(number, z)
                    .filter(|t| t.seen != 0)
                    .map(|t| t.confidence)
            };
            assert_eq!(shown(a), shown(b));
        }
    }
    let plain = nbvmap::serialise(&random(5, 12, [1, 3, 1]));
    assert!(nbvmap::parse(&plain, Some(&octree)).is_err_and(|e| e.contains("view history")));
    let payload = octree.view_history().unwrap().serialise();
    for cut in [0, 3, 5, payload.len() / 2, payload.len() - 1] {
        assert!(ViewHistory::parse(&payload[..cut], octree.bricks()).is_err());
    }
}

proptest! {
    #[test]
    fn damaged_histories_are_refused_or_read(seed: u64, at: prop::sample::Index, with: u8) {
        let mut octree = random(seed, 4, [1, 3, 1]).with_view_history();
        octree.record_view(&camera(), &views()[0], 2.2).unwrap();
        let mut payload = octree.view_history().unwrap().serialise();
        let at = at.index(payload.len());
        payload[at] = with;
        let _ = ViewHistory::parse(&payload, octree.bricks());
    }
}

#[test]
fn only_known_voxels_are_remembered_and_only_if_asked_for() {
    let view = Pose::from_yaw_pitch(Vec3::splat(0.05), 0.0, 0.0);
    let mut octree = empty();
    assert!(octree
        .record_view(&camera(), &view, 2.0)
        .unwrap_err()
        .to_string()
        .contains("view history"));
    observe(&mut octree, [IVec3::new(10, 0, 0)], true, 0.5);
    let mut octree = octree.with_view_history();
    octree.record_view(&camera(), &view, 2.0).unwrap();
    let history = octree.view_history().unwrap();
    let seen: u32 = (0..8)
        .filter_map(|z| history.total(0, z))
        .map(|t| t.seen.count_ones())
        .sum();
    assert_eq!(seen, 1);
    let i = voxel_in_brick(IVec3::new(10, 0, 0));
    // The sensor stands in the direction of -x: azimuth 180 degrees, and level: the 18th and 9th direction.
    let (_, block) = history.block(0, i / LAYER, 18 * ELEVATIONS + 9).unwrap();
    assert_eq!(
        block.log_odds[i % LAYER],
        octree.log_odds(IVec3::new(10, 0, 0)).unwrap()
    );
}
