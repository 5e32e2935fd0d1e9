//! Frontiers: where known free space borders on unknown space (Yamauchi 1997).
use super::grid::OccupancyGrid;
use super::octree::{Brick, KeyBox, Octree, State};
use crate::geometry::{Aabb, IVec3};

const COLUMN_0: u64 = 0x0101_0101_0101_0101;

/// Keys of the known free voxels with an unknown voxel among their six neighbours, both within `bounds` (metres). Bricks
/// in the order in which they were first seen.
pub fn frontier_voxels(octree: &Octree, bounds: Option<&Aabb>) -> Vec<IVec3> {
    let bounds = bounds.map(|b| KeyBox::touching(octree, b));
    let mut keys = Vec::new();
    let brick_at = |corner: IVec3| {
        let cell = octree.root().index(corner)?;
        octree.root().brick(cell).map(|b| &octree.bricks()[b])
    };
    for (number, brick) in octree.bricks().iter().enumerate() {
        let corner = octree.brick_coordinates(number);
        let mask = |corner: IVec3| bounds.map_or([u64::MAX; 8], |b| b.mask(corner));
        let inside = mask(corner);
        let free: [u64; 8] =
            std::array::from_fn(|w| brick.known[w] & !brick.occupied[w] & inside[w]);
        if free == [0; 8] {
            continue;
        }
        let unknown = |corner: IVec3, brick: Option<&Brick>| -> [u64; 8] {
            let inside = mask(corner);
            std::array::from_fn(|w| brick.map_or(u64::MAX, |b| !b.known[w]) & inside[w])
        };
        let at = |dx, dy, dz| {
            let neighbour = corner + IVec3::new(dx, dy, dz);
            unknown(neighbour, brick_at(neighbour))
        };
        let own = unknown(corner, Some(brick));
        let (west, east) = (at(-1, 0, 0), at(1, 0, 0));
        let (south, north) = (at(0, -1, 0), at(0, 1, 0));
        let (below, above) = (at(0, 0, -1), at(0, 0, 1));
        for w in 0..8 {
            // Bit i: the neighbour of voxel i on that side is unknown.
            let x_plus = (own[w] >> 1 & !(COLUMN_0 << 7)) | (east[w] & COLUMN_0) << 7;
            let x_minus = (own[w] << 1 & !COLUMN_0) | (west[w] >> 7 & COLUMN_0);
            let y_plus = own[w] >> 8 | north[w] << 56;
            let y_minus = own[w] << 8 | south[w] >> 56;
            let z_plus = if w == 7 { above[0] } else { own[w + 1] };
            let z_minus = if w == 0 { below[7] } else { own[w - 1] };
            let mut bits = free[w] & (x_plus | x_minus | y_plus | y_minus | z_plus | z_minus);
            while bits != 0 {
                let bit = bits.trailing_zeros() as i32;
                bits &= bits - 1;
                keys.push((corner << 3) + IVec3::new(bit & 7, bit >> 3, w as i32));
            }
        }
    }
    keys
}

/// A connected set of frontier cells of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Cluster {
    /// (column x, row y), in the order in which they were found.
    pub cells: Vec<(usize, usize)>,
    /// Mean of the cells' centres, metres; it need not be free.
    pub centroid: (f32, f32),
    /// The cell nearest to the centroid (the first of several).
    pub representative: (usize, usize),
}

/// Clusters (8-neighbours) of at least `min_cells` frontier cells, in the order of their first cell, rows first. A frontier
/// cell is a free cell with an unknown one among its four neighbours.
pub fn frontier_clusters(grid: &OccupancyGrid, min_cells: usize) -> Vec<Cluster> {
    let (width, height) = (grid.width(), grid.height());
    let around = |x: usize, y: usize, reach_diagonals: bool| {
        (-1isize..=1)
            .flat_map(move |dy| (-1isize..=1).map(move |dx| (dx, dy)))
            .filter_map(move |(dx, dy)| {
                let (x, y) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
                let apart = dx.abs() + dy.abs();
                (apart == 1 || (reach_diagonals && apart == 2))
                    .then_some((x, y))
                    .filter(|c| c.0 < width && c.1 < height)
            })
    };
    let mut open: Vec<bool> = (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            grid.state(x, y) == State::Free
                && around(x, y, false).any(|(x, y)| grid.state(x, y) == State::Unknown)
        })
        .collect();
    let mut clusters = Vec::new();
    for start in 0..open.len() {
        if !open[start] {
            continue;
        }
        open[start] = false;
        let mut cells = vec![(start % width, start / width)];
        let mut next = 0;
        while next < cells.len() {
            let (x, y) = cells[next];
            next += 1;
            for (x, y) in around(x, y, true) {
                if std::mem::take(&mut open[y * width + x]) {
                    cells.push((x, y));
                }
            }
        }
        if cells.len() >= min_cells.max(1) {
            clusters.push(cluster(grid, cells));
        }
    }
    clusters
}

fn cluster(grid: &OccupancyGrid, cells: Vec<(usize, usize)>) -> Cluster {
    let n = cells.len() as f64;
    let (sx, sy) = cells
        .iter()
        .fold((0.0, 0.0), |(sx, sy), c| (sx + c.0 as f64, sy + c.1 as f64));
    let (mx, my) = (sx / n, sy / n);
    let squared = |c: &(usize, usize)| (c.0 as f64 - mx).powi(2) + (c.1 as f64 - my).powi(2);
    let representative = cells
        .iter()
        .copied()
        .min_by(|a, b| squared(a).total_cmp(&squared(b)))
        .unwrap_or((0, 0));
    let corner = grid.center(0, 0);
    let size = grid.resolution();
    Cluster {
        cells,
        centroid: (corner.x + mx as f32 * size, corner.y + my as f32 * size),
        representative,
    }
}

#[cfg(test)]
mod tests;
