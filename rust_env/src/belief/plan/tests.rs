use super::*;
use crate::belief::octree::State;
use crate::belief::testing::{empty, keys, observe, random, room, RESOLUTION};
use crate::geometry::IVec3;
use proptest::prelude::*;

const RADIUS: f32 = 0.15;

fn bounds(half: f32) -> Aabb {
    Aabb::new(Vec3::splat(-half), Vec3::splat(half))
}

fn length(path: &[Vec3]) -> f32 {
    path.windows(2).map(|w| w[0].distance(w[1])).sum()
}

/// Two rooms of 2 x 2 x 1.5 m with a wall between them at x = 2.0..2.1 m that has a door, 0.7 m wide, at y = 0.2..0.9 m.
fn two_rooms(door: bool) -> Octree {
    let mut octree = room(IVec3::new(41, 20, 15));
    let open = |k: &IVec3| door && (2..9).contains(&k.y);
    for _ in 0..5 {
        let wall = keys(IVec3::new(20, 0, 0), IVec3::new(21, 20, 15));
        observe(&mut octree, wall.filter(|k| !open(k)), true, 0.5);
    }
    octree
}

fn house() -> Aabb {
    Aabb::new(Vec3::splat(-0.05), Vec3::new(4.15, 2.05, 1.55))
}

#[test]
fn a_clear_line_is_the_plan() {
    let (a, b) = (Vec3::new(0.5, 1.0, 0.7), Vec3::new(1.5, 0.4, 1.0));
    assert_eq!(
        plan(&two_rooms(true), &house(), a, b, RADIUS).unwrap(),
        [a, b]
    );
}

#[test]
fn the_plan_goes_through_the_door() {
    let octree = two_rooms(true);
    let (a, b) = (Vec3::new(0.5, 1.6, 0.7), Vec3::new(3.5, 1.6, 0.7));
    let path = plan(&octree, &house(), a, b, RADIUS).unwrap();
    assert_eq!((path[0], path[path.len() - 1]), (a, b));
    for w in path.windows(2) {
        assert!(segment_is_clear(&octree, w[0], w[1], RADIUS - 0.01, true));
        // Where it passes the wall's plane it is in the door.
        if (w[0].x - 2.05) * (w[1].x - 2.05) < 0.0 {
            let y = w[0].lerp(w[1], (2.05 - w[0].x) / (w[1].x - w[0].x)).y;
            assert!((0.3..0.8).contains(&y), "{y}");
        }
    }
    // Around the door post at (2.05, 0.75): about 2 * hypot(1.5, 0.9).
    assert!(
        path.len() <= 6 && (3.2..3.9).contains(&length(&path)),
        "{path:?}"
    );
    let travel = travel_costs(
        &octree,
        &house(),
        a,
        &[b, a, Vec3::new(9.0, 0.0, 0.0), Vec3::new(2.05, 1.6, 0.7)],
        RADIUS,
    );
    assert!(
        travel[0] >= length(&path) - 0.2 && travel[0] < 1.1 * length(&path),
        "{travel:?}"
    );
    assert_eq!(travel[1], 0.0);
    assert_eq!(&travel[2..], [f32::INFINITY; 2]);
    assert_eq!(
        reachable(
            &octree,
            &house(),
            a,
            &[b, a, Vec3::new(2.05, 1.6, 0.7)],
            RADIUS
        ),
        [true, true, false]
    );
}

#[test]
fn no_door_no_way() {
    let octree = two_rooms(false);
    let (a, b) = (Vec3::new(0.5, 1.6, 0.7), Vec3::new(3.5, 1.6, 0.7));
    assert_eq!(plan(&octree, &house(), a, b, RADIUS), None);
    assert_eq!(
        travel_costs(&octree, &house(), a, &[b], RADIUS),
        [f32::INFINITY]
    );
    assert_eq!(reachable(&octree, &house(), a, &[b], RADIUS), [false]);
}

#[test]
fn a_door_narrower_than_the_body_is_closed() {
    let octree = two_rooms(true);
    let (a, b) = (Vec3::new(0.9, 1.0, 0.7), Vec3::new(3.2, 1.0, 0.7));
    assert!(plan(&octree, &house(), a, b, 0.3).is_some());
    assert_eq!(plan(&octree, &house(), a, b, 0.37), None);
}

#[test]
fn unknown_space_is_passable_but_not_known_to_be_reachable() {
    let mut octree = empty();
    observe(
        &mut octree,
        keys(IVec3::splat(-5), IVec3::splat(5)),
        false,
        1.0,
    );
    let (a, inside, outside) = (Vec3::splat(0.05), Vec3::splat(0.35), Vec3::splat(0.85));
    assert_eq!(
        reachable(&octree, &bounds(1.0), a, &[inside, outside], RADIUS),
        [true, false]
    );
    let travel = travel_costs(&octree, &bounds(1.0), a, &[inside, outside], RADIUS);
    // Space diagonals of the lattice.
    assert!(
        (travel[0] - 0.3 * 3f32.sqrt()).abs() < 1e-3
            && (travel[1] - 0.8 * 3f32.sqrt()).abs() < 1e-3,
        "{travel:?}"
    );
    assert_eq!(
        reachable(&empty(), &bounds(1.0), a, &[a], RADIUS),
        [false],
        "not even known to be free itself"
    );
}

#[test]
fn a_robot_in_contact_gets_away() {
    let octree = two_rooms(true);
    let a = Vec3::new(0.05, 1.0, 0.7);
    assert!(!segment_is_clear(&octree, a, a, RADIUS, true));
    let b = Vec3::new(3.5, 1.6, 0.7);
    assert!(plan(&octree, &house(), a, b, RADIUS).is_some());
    assert!(travel_costs(&octree, &house(), a, &[b], RADIUS)[0].is_finite());
}

#[test]
fn places_outside_the_key_space_have_no_way() {
    let octree = empty();
    let far = Vec3::splat(1e7);
    assert_eq!(plan(&octree, &bounds(1.0), far, Vec3::ZERO, RADIUS), None);
    assert_eq!(plan(&octree, &bounds(1.0), Vec3::ZERO, far, RADIUS), None);
    assert_eq!(
        travel_costs(&octree, &bounds(1.0), far, &[Vec3::ZERO], RADIUS),
        [f32::INFINITY]
    );
    assert_eq!(
        travel_costs(&octree, &bounds(1.0), Vec3::ZERO, &[far, Vec3::NAN], RADIUS),
        [f32::INFINITY; 2]
    );
    assert_eq!(
        reachable(&octree, &bounds(1.0), far, &[Vec3::ZERO], RADIUS),
        [false]
    );
}

#[test]
fn on_a_grid_the_way_leads_around_the_wall() {
    let octree = two_rooms(true);
    let grid = OccupancyGrid::slice(&octree, 0.5, 0.9, &house())
        .unwrap()
        .inflate(RADIUS);
    let (a, b) = (Vec2::new(0.55, 1.65), Vec2::new(3.55, 1.65));
    let (path, metres) = plan_on_grid(&grid, a, b, None).unwrap();
    assert!(path[0].distance(a) < 1e-5 && path[path.len() - 1].distance(b) < 1e-5);
    let sum: f32 = path.windows(2).map(|w| w[0].distance(w[1])).sum();
    assert!((sum - metres).abs() < 1e-3 && (3.2..3.9).contains(&metres));
    assert!(path.iter().all(|p| grid
        .cell(p.x, p.y)
        .is_some_and(|(x, y)| grid.state(x, y) == State::Free)));
    assert!(plan_on_grid(&grid, a, Vec2::new(2.05, 1.65), Some(1)).is_none());
    assert!(plan_on_grid(&grid, a, Vec2::new(9.0, 1.65), Some(1)).is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn costs_obey_the_laws(
        seed in 0u64..1000,
        occupied in 1u32..12,
        a in [-6i32..6, -6i32..6, -6i32..6],
        b in [-6i32..6, -6i32..6, -6i32..6],
        radius in prop::sample::select(vec![0.0f32, 0.04, 0.06, 0.12]),
        unknown in prop::sample::select(vec![Unknown::Forbidden, Unknown::Factor(1), Unknown::Factor(2), Unknown::Factor(9)]),
    ) {
        let octree = random(seed, 6, [10, 20, occupied]);
        let region = KeyBox { min: IVec3::splat(-6), max: IVec3::splat(6) };
        let (a, b) = (IVec3::from_array(a), IVec3::from_array(b));
        // Radius 0 and the same start on both ways: the exemption around the start must not differ.
        let voxels = VoxelLattice::new(&octree, region, a, radius, unknown).unwrap();
        let lattice = &voxels.lattice;
        let (from, to) = (voxels.index(a).unwrap(), voxels.index(b).unwrap());
        let all = lattice.costs(from, &[]);
        // A* finds what Dijkstra finds, there and back.
        let there = lattice.path(from, to, usize::MAX);
        prop_assert_eq!(there.as_ref().map_or(UNREACHED, |p| p.1), if lattice.is_passable(to) { all[to] } else { UNREACHED });
        prop_assert_eq!(lattice.path(to, from, usize::MAX).map(|p| p.1), there.as_ref().map(|p| p.1));
        // Stopping early does not change the goals' costs.
        if lattice.is_passable(to) {
            prop_assert_eq!(lattice.costs(from, &[to])[to], all[to]);
        }
        // The flood reaches exactly what has a cost.
        let reached = lattice.flood(from);
        for (i, r) in reached.iter().enumerate() {
            prop_assert_eq!(*r, all[i] != UNREACHED);
        }
        // Bellman: no step improves a cost, and every cost but the start's is met by a step.
        let centers = |i: usize| octree.center(voxels.key(i));
        if let Some((path, cost)) = there {
            prop_assert_eq!((path[0], *path.last().unwrap()), (from, to));
            let mut metres = 0.0;
            for w in path.windows(2) {
                prop_assert!((voxels.key(w[0]) - voxels.key(w[1])).abs().max_element() == 1);
                metres += centers(w[0]).distance(centers(w[1]));
                // No occupied voxel is touched or cut: all voxels of the block between both are passable.
                let (k, l) = (voxels.key(w[0]), voxels.key(w[1]));
                for key in keys(k.min(l), k.max(l) + 1) {
                    prop_assert!(octree.state(key) != State::Occupied || key == a);
                    if unknown == Unknown::Forbidden {
                        prop_assert!(octree.state(key) == State::Free || key == a);
                    }
                }
            }
            let cost = f64::from(cost) / f64::from(UNIT) * RESOLUTION;
            if unknown == Unknown::Factor(1) {
                prop_assert!((cost - f64::from(metres)).abs() < 2e-3);
            }
            prop_assert!(cost >= f64::from(metres) - 2e-3);
        }
    }

    #[test]
    fn plans_are_clear(
        seed in 0u64..1000,
        a in [-0.55f32..0.55, -0.55f32..0.55, -0.55f32..0.55],
        b in [-0.55f32..0.55, -0.55f32..0.55, -0.55f32..0.55],
    ) {
        let octree = random(seed, 6, [3, 30, 4]);
        let (a, b) = (Vec3::from_array(a), Vec3::from_array(b));
        let blocked = |p: Vec3| octree.state(octree.key(p).unwrap()) == State::Occupied;
        prop_assume!(!blocked(a) && !blocked(b));
        let box_ = bounds(0.59);
        let Some(path) = plan(&octree, &box_, a, b, 0.0) else {
            prop_assert_eq!(travel_costs(&octree, &box_, a, &[b], 0.0), [f32::INFINITY]);
            return Ok(());
        };
        prop_assert_eq!((path[0], *path.last().unwrap()), (a, b));
        prop_assert!(length(&path) <= travel_costs(&octree, &box_, a, &[b], 0.0)[0] * f32::from(UNKNOWN_FACTOR) + 0.35);
        for w in path.windows(2) {
            for i in 0..=100 {
                prop_assert!(!blocked(w[0].lerp(w[1], i as f32 / 100.0)));
            }
        }
    }
}
