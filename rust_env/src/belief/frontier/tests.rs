use super::*;
use crate::belief::testing::{empty, keys, observe, random, room};
use crate::geometry::Vec3;
use proptest::prelude::*;
use std::collections::HashSet;

const SIDES: [IVec3; 6] = [
    IVec3::X,
    IVec3::NEG_X,
    IVec3::Y,
    IVec3::NEG_Y,
    IVec3::Z,
    IVec3::NEG_Z,
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn frontier_voxels_equal_their_definition(seed in 0u64..1000, half in 1i32..14, unknown in 1u32..30, bounded in any::<bool>()) {
        let octree = random(seed, half, [unknown, 10, 2]);
        let bounds = bounded.then(|| Aabb::new(Vec3::new(-0.75, -0.4, -0.9), Vec3::new(0.9, 0.35, 0.75)));
        let region = bounds.map(|b| KeyBox::touching(&octree, &b));
        let inside = |k: IVec3| region.is_none_or(|r| r.contains(k));
        let expected: HashSet<IVec3> = keys(IVec3::splat(-half), IVec3::splat(half))
            .filter(|k| inside(*k) && octree.state(*k) == State::Free)
            .filter(|k| SIDES.iter().any(|s| inside(*k + *s) && octree.state(*k + *s) == State::Unknown))
            .collect();
        let got = frontier_voxels(&octree, bounds.as_ref());
        prop_assert_eq!(got.len(), expected.len());
        prop_assert_eq!(got.into_iter().collect::<HashSet<_>>(), expected);
    }
}

#[test]
fn a_closed_room_has_no_frontier() {
    let mut octree = room(IVec3::new(17, 9, 12));
    assert!(frontier_voxels(&octree, None).is_empty());
    observe(&mut octree, [IVec3::new(17, 4, 5)], false, 1.0);
    observe(&mut octree, [IVec3::new(17, 4, 5)], false, 1.0);
    observe(&mut octree, [IVec3::new(17, 4, 5)], false, 1.0);
    assert_eq!(
        frontier_voxels(&octree, None),
        [IVec3::new(17, 4, 5)],
        "a hole in the wall"
    );
    assert!(frontier_voxels(&empty(), None).is_empty());
}

/// Rows from top to bottom as y ascends: f(ree), o(ccupied), u(nknown).
fn grid(rows: &[&str]) -> OccupancyGrid {
    let mut octree = empty();
    for (y, row) in rows.iter().enumerate() {
        for (x, c) in row.chars().enumerate() {
            if c != 'u' {
                observe(
                    &mut octree,
                    [IVec3::new(x as i32, y as i32, 0)],
                    c == 'o',
                    0.5,
                );
            }
        }
    }
    let high = Vec3::new(
        rows[0].len() as f32 * 0.1 - 0.05,
        rows.len() as f32 * 0.1 - 0.05,
        0.05,
    );
    OccupancyGrid::slice(&octree, 0.05, 0.05, &Aabb::new(Vec3::splat(0.05), high)).unwrap()
}

#[test]
fn clusters_join_diagonally_and_drop_small_ones() {
    let grid = grid(&[
        "ooooooooo",
        "ofuffffuo", //
        "offfffffo",
        "offffffuo",
        "ouuffffoo",
    ]);
    // (1,1) (3,1) (2,2) hang together by corners around the unknown (2,1); (1,3) (2,3) (3,4) around (1,4), (2,4);
    // (6,1) (7,2) (6,3) around (7,1) and (7,3).
    let clusters = frontier_clusters(&grid, 1);
    let mut all: Vec<Vec<(usize, usize)>> = clusters
        .iter()
        .map(|c| {
            let mut cells = c.cells.clone();
            cells.sort_unstable();
            cells
        })
        .collect();
    all.sort();
    assert_eq!(
        all,
        [
            vec![(1, 1), (1, 3), (2, 2), (2, 3), (3, 1), (3, 4)],
            vec![(6, 1), (6, 3), (7, 2)],
        ]
    );
    let large = frontier_clusters(&grid, 4);
    assert_eq!(large.len(), 1);
    let small = clusters.iter().find(|c| c.cells.len() == 3).unwrap();
    // Mean of (6,1) (6,3) (7,2): column 19/3, row 2.
    assert!((small.centroid.0 - (19.0 / 3.0 + 0.5) * 0.1).abs() < 1e-5);
    assert!((small.centroid.1 - 0.25).abs() < 1e-5);
    assert_eq!(small.representative, (7, 2));
}
