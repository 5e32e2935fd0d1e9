//! Ways through the map for a spherical body: paths, travel costs, reachability.
//!
//! All stay within the bounds (voxels that the box touches) and keep the body's radius from occupied voxels, measured from
//! voxel centres; a robot that is in contact may get away from it.
use super::grid::{OccupancyGrid, Vec2};
use super::lattice::{Lattice, Unknown, VoxelLattice, UNIT, UNREACHED};
use super::octree::{KeyBox, Octree};
use super::viewpoints::segment_is_clear;
use crate::geometry::{Aabb, Vec3};

/// A path through unknown space is as long as one through known free space that is this many times longer.
pub const UNKNOWN_FACTOR: u8 = 2;
/// Most cells that A* expands.
pub const MAX_EXPANSIONS: usize = 4_000_000;

fn lattice(
    octree: &Octree,
    bounds: &Aabb,
    from: Vec3,
    radius: f32,
    unknown: Unknown,
) -> Option<(VoxelLattice, usize)> {
    let start = octree.key(from)?;
    let region = KeyBox::touching(octree, bounds).union(&KeyBox {
        min: start,
        max: start + 1,
    });
    let lattice = VoxelLattice::new(octree, region, start, radius, unknown).ok()?;
    let from = lattice.index(start)?;
    Some((lattice, from))
}

/// Way-points (positions, metres) from `from` to `to`, both included: the straight line if nothing known is in the way, else
/// a shortest path (unknown space costs `UNKNOWN_FACTOR` times as much) with needless way-points taken out. `None` if there
/// is no way, or either end lies outside the map's key space.
pub fn plan(
    octree: &Octree,
    bounds: &Aabb,
    from: Vec3,
    to: Vec3,
    radius: f32,
) -> Option<Vec<Vec3>> {
    if segment_is_clear(octree, from, to, radius, true) {
        return Some(vec![from, to]);
    }
    let (voxels, start) = lattice(
        octree,
        bounds,
        from,
        radius,
        Unknown::Factor(UNKNOWN_FACTOR),
    )?;
    let goal = voxels.index(octree.key(to)?)?;
    let (path, _) = voxels.lattice.path(start, goal, MAX_EXPANSIONS)?;
    let mut points = voxels.centers(octree, &path);
    if points.len() < 2 {
        points = vec![from; 2];
    }
    let last = points.len() - 1;
    (points[0], points[last]) = (from, to);
    Some(shortened(octree, &points, radius))
}

/// Take way-points out as long as the straight line past them is clear.
fn shortened(octree: &Octree, points: &[Vec3], radius: f32) -> Vec<Vec3> {
    let mut path = vec![points[0]];
    let mut at = 0;
    while at + 1 < points.len() {
        let mut next = at + 1;
        while next + 1 < points.len()
            && segment_is_clear(octree, points[at], points[next + 1], radius, true)
        {
            next += 1;
        }
        path.push(points[next]);
        at = next;
    }
    path
}

/// Metres of the shortest way from `from` to each goal through space that is not known to be occupied, along the voxel
/// lattice (up to 13 % longer than the straight line); infinite where there is none. One search serves all goals.
pub fn travel_costs(
    octree: &Octree,
    bounds: &Aabb,
    from: Vec3,
    goals: &[Vec3],
    radius: f32,
) -> Vec<f32> {
    let Some((voxels, start)) = lattice(octree, bounds, from, radius, Unknown::Factor(1)) else {
        return vec![f32::INFINITY; goals.len()];
    };
    let cells = cells(octree, &voxels, goals);
    let wanted: Vec<usize> = cells.iter().flatten().copied().collect();
    if wanted.is_empty() {
        return vec![f32::INFINITY; goals.len()];
    }
    let costs = voxels.lattice.costs(start, &wanted);
    let metres = |cost: u32| (f64::from(cost) / f64::from(UNIT) * octree.resolution()) as f32;
    cells
        .into_iter()
        .map(|cell| match cell.map(|c| costs[c]) {
            None | Some(UNREACHED) => f32::INFINITY,
            Some(cost) => metres(cost),
        })
        .collect()
}

/// Which goals can be reached from `from` through known free space.
pub fn reachable(
    octree: &Octree,
    bounds: &Aabb,
    from: Vec3,
    goals: &[Vec3],
    radius: f32,
) -> Vec<bool> {
    let Some((voxels, start)) = lattice(octree, bounds, from, radius, Unknown::Forbidden) else {
        return vec![false; goals.len()];
    };
    let reached = voxels.lattice.flood(start);
    cells(octree, &voxels, goals)
        .into_iter()
        .map(|cell| cell.is_some_and(|c| reached[c]))
        .collect()
}

fn cells(octree: &Octree, voxels: &VoxelLattice, goals: &[Vec3]) -> Vec<Option<usize>> {
    goals
        .iter()
        .map(|g| octree.key(*g).and_then(|k| voxels.index(k)))
        .collect()
}

/// The shortest way on a grid from one point to another, as cell centres (metres), and its length in metres (unknown cells
/// count `factor` times; `None` forbids them). Steps go to eight neighbours and cut no occupied corner; inflate the grid for
/// the body first. `None` if there is no way or an end lies outside.
pub fn plan_on_grid(
    grid: &OccupancyGrid,
    from: Vec2,
    to: Vec2,
    factor: Option<u8>,
) -> Option<(Vec<Vec2>, f32)> {
    let lattice = Lattice::of_grid(grid, factor.map_or(Unknown::Forbidden, Unknown::Factor));
    let index = |p: Vec2| {
        grid.cell(p.x, p.y)
            .map(|(x, y)| Lattice::grid_index(grid, x, y))
    };
    let (path, cost) = lattice.path(index(from)?, index(to)?, MAX_EXPANSIONS)?;
    let points = path
        .into_iter()
        .map(|i| lattice.coordinates(i))
        .map(|[x, y, _]| grid.center(x - 1, y - 1))
        .collect();
    Some((
        points,
        (f64::from(cost) / f64::from(UNIT) * f64::from(grid.resolution())) as f32,
    ))
}

#[cfg(test)]
mod tests;
