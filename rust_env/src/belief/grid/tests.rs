use super::*;
use crate::belief::testing::{empty, keys, observe, random, room};

#[test]
fn columns_follow_the_rule() {
    let mut octree = empty();
    // Columns of four voxels: x = 0 all free, 1 one unknown, 2 two unknown, 3 three unknown, 4 occupied among unknown.
    for (x, free) in [4, 3, 2, 1, 0].into_iter().enumerate() {
        let x = x as i32;
        observe(
            &mut octree,
            keys(IVec3::new(x, 0, 0), IVec3::new(x + 1, 1, free)),
            false,
            1.0,
        );
    }
    observe(&mut octree, [IVec3::new(4, 0, 2)], true, 0.5);
    let bounds = Aabb::new(Vec3::splat(0.01), Vec3::new(0.55, 0.05, 0.35));
    let grid = OccupancyGrid::slice(&octree, 0.01, 0.39, &bounds).unwrap();
    use State::*;
    assert_eq!(grid.cells(), [Free, Free, Free, Unknown, Occupied, Unknown]);
    assert_eq!((grid.width(), grid.height()), (6, 1));
    // Above the occupied voxel.
    assert_eq!(
        OccupancyGrid::slice(&octree, 0.31, 0.39, &bounds)
            .unwrap()
            .state(4, 0),
        Unknown
    );
}

#[test]
fn cells_and_metres_agree() {
    let octree = random(5, 6, [1, 2, 1]);
    let bounds = Aabb::new(Vec3::new(-0.53, -0.31, 0.0), Vec3::new(0.44, 0.52, 0.0));
    let grid = OccupancyGrid::slice(&octree, 0.2, 0.2, &bounds).unwrap();
    assert_eq!((grid.width(), grid.height()), (11, 10));
    assert!((grid.origin() - Vec2::new(-0.6, -0.4)).length() < 1e-6);
    for y in 0..grid.height() {
        for x in 0..grid.width() {
            let c = grid.center(x, y);
            assert_eq!(grid.cell(c.x, c.y), Some((x, y)));
            // One layer: the cell is the voxel.
            let key = octree.key(Vec3::new(c.x, c.y, 0.2)).unwrap();
            assert_eq!(grid.state(x, y), octree.state(key));
        }
    }
    assert_eq!(grid.cell(-0.61, 0.0), None);
    assert_eq!(grid.cell(f32::NAN, 0.0), None);
    assert_eq!(grid.state(11, 0), State::Unknown);
}

#[test]
fn walls_grow_by_the_radius() {
    let octree = room(IVec3::new(20, 10, 5));
    let bounds = Aabb::new(Vec3::splat(-0.05), Vec3::new(2.05, 1.05, 0.45));
    let grid = OccupancyGrid::slice(&octree, 0.2, 0.3, &bounds)
        .unwrap()
        .inflate(0.2);
    for y in 0..grid.height() {
        for x in 0..grid.width() {
            let c = grid.center(x, y);
            // Centres 0.05 and 0.15 m from the wall are nearer than 0.2 m.
            let near = c.x < 0.2 || c.y < 0.2 || c.x > 1.8 || c.y > 0.8;
            assert_eq!(grid.state(x, y) == State::Occupied, near, "{c}");
        }
    }
}

#[test]
fn bad_boxes_are_errors_and_empty_ones_empty() {
    let octree = empty();
    let bounds = Aabb::new(Vec3::ZERO, Vec3::ONE);
    assert!(OccupancyGrid::slice(&octree, 1.0, 0.0, &bounds).is_err());
    assert!(OccupancyGrid::slice(&octree, f32::NAN, 0.0, &bounds).is_err());
    assert!(OccupancyGrid::slice(
        &octree,
        0.0,
        1.0,
        &Aabb::new(Vec3::ZERO, Vec3::splat(2000.0))
    )
    .is_err());
    assert!(OccupancyGrid::slice(&octree, 0.0, 1.0, &Aabb::EMPTY)
        .unwrap()
        .cells()
        .is_empty());
    assert!(OccupancyGrid::slice(&octree, 0.0, 1.0, &bounds)
        .unwrap()
        .cells()
        .iter()
        .all(|c| *c == State::Unknown));
}
