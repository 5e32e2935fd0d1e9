//! Where a body may be, on the lattice of a map's voxels or a grid's cells, and shortest ways through it.
//!
//! A step goes to one of 26 neighbours (8 on a grid); a diagonal one needs every cell that it cuts to be passable. Costs
//! are integers (`UNIT` a straight step), so that ways and ties do not depend on the machine.
use super::distance;
use super::gain::{Layers, Window, OCCUPIED, UNKNOWN, WALL};
use super::grid::OccupancyGrid;
use super::octree::{KeyBox, Octree, State};
use crate::error::{Error, Result};
use crate::geometry::{IVec3, Vec3};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Cost of a straight step through known free space; diagonal ones are right to 1 in 10 000.
pub const UNIT: u32 = 1 << 12;
const STEP: [u32; 4] = [0, UNIT, 5_793, 7_094];
/// Also the cost of ways longer than a million straight steps.
pub const UNREACHED: u32 = u32::MAX;
/// Most cells of a lattice.
const MAX_CELLS: u64 = 1 << 26;

/// Cells are blocked, free, or unknown.
const BLOCKED: u8 = 0;
const FREE: u8 = 1;
const OPEN: u8 = 2;

/// How dear unknown space is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unknown {
    Forbidden,
    /// A step in unknown space costs this many times a step in known free space (1 ..= 16).
    Factor(u8),
}

pub struct Lattice {
    dims: [usize; 3],
    cells: Vec<u8>,
    /// Of each cell, which of the three cells around it in its row are passable (bit 0: x - 1).
    rows: Vec<u8>,
    /// The 26 steps: change of index, steps along the axes, bits of the cells cut (see `neighbourhood`).
    moves: Vec<Move>,
    factor: [u32; 3],
}

struct Move {
    shift: isize,
    cost: u32,
    needs: u32,
}

/// The voxel lattice of a map within a box.
pub struct VoxelLattice {
    pub lattice: Lattice,
    origin: IVec3,
    region: KeyBox,
}

impl VoxelLattice {
    /// Passable are the voxels of `region` with no occupied voxel nearer than `radius` metres to their centre, and those
    /// within the body's reach of `start` that are not occupied themselves (so that a robot in contact can get away).
    pub fn new(
        octree: &Octree,
        region: KeyBox,
        start: IVec3,
        radius: f32,
        unknown: Unknown,
    ) -> Result<Self> {
        if region.grown(1).volume() > MAX_CELLS {
            return Err(Error::invalid(format!(
                "a way through {} voxels is too much to search; use smaller bounds or a coarser map",
                region.volume()
            )));
        }
        let window = Window::new(octree, region, None, Layers::default())?;
        let dims = window.dims.to_array().map(|n| n as usize);
        let state = &window.state[..dims[0] * dims[1] * dims[2]];
        let reach = radius / octree.resolution() as f32;
        let near = distance::inflated(state.iter().map(|s| *s == OCCUPIED), dims, reach);
        let mut cells: Vec<u8> = (state.iter().zip(&near))
            .map(
                |(s, near)| match (*near || *s & (OCCUPIED | WALL) != 0, *s) {
                    (true, _) => BLOCKED,
                    (_, UNKNOWN) => OPEN,
                    _ => FREE,
                },
            )
            .collect();
        let around = reach.ceil() as i32 + 1;
        let body = KeyBox {
            min: start,
            max: start + 1,
        }
        .grown(around.min(128))
        .intersection(&region);
        for z in body.min.z..body.max.z {
            for y in body.min.y..body.max.y {
                for x in body.min.x..body.max.x {
                    let key = IVec3::new(x, y, z);
                    let i = window.index(key);
                    let close = (key - start).as_vec3().length() <= reach + 1.0;
                    if cells[i] == BLOCKED && close && (state[i] != OCCUPIED || key == start) {
                        cells[i] = if state[i] == UNKNOWN { OPEN } else { FREE };
                    }
                }
            }
        }
        Ok(Self {
            origin: window.origin,
            region,
            lattice: Lattice::new(dims, cells, unknown),
        })
    }

    pub fn index(&self, key: IVec3) -> Option<usize> {
        let [nx, ny, _] = self.lattice.dims;
        let c = key - self.origin;
        self.region
            .contains(key)
            .then(|| (c.z as usize * ny + c.y as usize) * nx + c.x as usize)
    }

    pub fn key(&self, index: usize) -> IVec3 {
        self.origin + IVec3::from_array(self.lattice.coordinates(index).map(|c| c as i32))
    }

    pub fn centers(&self, octree: &Octree, path: &[usize]) -> Vec<Vec3> {
        path.iter().map(|i| octree.center(self.key(*i))).collect()
    }
}

impl Lattice {
    /// The outermost cells must be blocked.
    fn new(dims: [usize; 3], cells: Vec<u8>, unknown: Unknown) -> Self {
        let (nx, ny) = (dims[0] as isize, dims[1] as isize);
        let bit = |d: [isize; 3]| 1u32 << ((d[2] + 1) * 9 + (d[1] + 1) * 3 + d[0] + 1);
        let mut moves = Vec::with_capacity(26);
        for n in 0..27isize {
            let d = [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1];
            let axes = d.iter().filter(|c| **c != 0).count();
            if axes == 0 {
                continue;
            }
            // Every cell of the block between here and there.
            let needs = (0..8).fold(0, |needs, part| {
                needs | bit([0, 1, 2].map(|a| if part >> a & 1 == 1 { d[a] } else { 0 }))
            });
            moves.push(Move {
                shift: (d[2] * ny + d[1]) * nx + d[0],
                cost: STEP[axes],
                needs: needs & !bit([0, 0, 0]),
            });
        }
        let factor = match unknown {
            Unknown::Forbidden => [0, 1, 0],
            Unknown::Factor(f) => [0, 1, u32::from(f.clamp(1, 16))],
        };
        let forbidden = unknown == Unknown::Forbidden;
        let cells: Vec<u8> = cells
            .into_iter()
            .map(|c| if forbidden && c == OPEN { BLOCKED } else { c })
            .collect();
        let mut rows = vec![0u8; cells.len()];
        let bit = |c: u8| u8::from(c != BLOCKED);
        for (row, c) in rows.iter_mut().skip(1).zip(cells.windows(3)) {
            *row = bit(c[0]) | bit(c[1]) << 1 | bit(c[2]) << 2;
        }
        Self {
            dims,
            cells,
            rows,
            moves,
            factor,
        }
    }

    /// The cells of a grid that are not occupied (inflate it first), with a blocked border around.
    pub fn of_grid(grid: &OccupancyGrid, unknown: Unknown) -> Self {
        let (w, h) = (grid.width() + 2, grid.height() + 2);
        let mut cells = vec![BLOCKED; w * h * 3];
        for y in 0..grid.height() {
            for x in 0..grid.width() {
                cells[Self::grid_index(grid, x, y)] = match grid.state(x, y) {
                    State::Occupied => BLOCKED,
                    State::Free => FREE,
                    State::Unknown => OPEN,
                };
            }
        }
        Self::new([w, h, 3], cells, unknown)
    }

    pub fn grid_index(grid: &OccupancyGrid, x: usize, y: usize) -> usize {
        (grid.height() + 2 + y + 1) * (grid.width() + 2) + x + 1
    }

    pub fn coordinates(&self, index: usize) -> [usize; 3] {
        let [nx, ny, _] = self.dims;
        [index % nx, index / nx % ny, index / nx / ny]
    }

    #[inline]
    pub fn is_passable(&self, cell: usize) -> bool {
        self.cells[cell] != BLOCKED
    }

    /// Which of the 27 cells around (and with) a passable cell are passable.
    #[inline]
    fn neighbourhood(&self, cell: usize) -> u32 {
        let (nx, ny) = (self.dims[0], self.dims[1]);
        let mut bits = 0;
        let middle = cell - nx * ny - nx;
        for z in 0..3 {
            for y in 0..3 {
                bits |= u32::from(self.rows[middle + (z * ny + y) * nx]) << (9 * z + 3 * y);
            }
        }
        bits
    }

    /// The steps from a passable cell: where to and at what cost. The mean of both cells' factors: the way back costs the same.
    #[inline]
    fn steps(&self, cell: usize) -> impl Iterator<Item = (usize, u32)> + '_ {
        let passable = self.neighbourhood(cell);
        let here = self.factor[self.cells[cell] as usize];
        self.moves
            .iter()
            .filter(move |m| passable & m.needs == m.needs)
            .map(move |m| {
                let next = cell.wrapping_add_signed(m.shift);
                (
                    next,
                    m.cost * (here + self.factor[self.cells[next] as usize]) / 2,
                )
            })
    }

    /// Least cost from `from` to every cell, `UNREACHED` where there is no way. Stops early once all `goals` are settled (the
    /// other costs are then upper bounds); no goals: goes on to the end.
    ///
    /// Dijkstra's algorithm with buckets as wide as the cheapest step: within a bucket no cell can improve another.
    pub fn costs(&self, from: usize, goals: &[usize]) -> Vec<u32> {
        let mut costs = vec![UNREACHED; self.cells.len()];
        if !self.is_passable(from) {
            return costs;
        }
        let dearest = STEP[3] * self.factor[FREE as usize].max(self.factor[OPEN as usize]);
        let mut buckets: Vec<Vec<u32>> = vec![Vec::new(); (dearest / UNIT) as usize + 2];
        let mut open: Vec<usize> = goals
            .iter()
            .copied()
            .filter(|g| self.is_passable(*g))
            .collect();
        open.sort_unstable();
        open.dedup();
        if !goals.is_empty() && open.is_empty() {
            costs[from] = 0;
            return costs;
        }
        let search_all = goals.is_empty();
        costs[from] = 0;
        buckets[0].push(from as u32);
        let mut settled = vec![false; self.cells.len()];
        let (mut level, mut waiting) = (0u32, 1usize);
        while waiting > 0 {
            let slot = (level % buckets.len() as u32) as usize;
            let mut bucket = std::mem::take(&mut buckets[slot]);
            waiting -= bucket.len();
            for cell in bucket.drain(..) {
                let cell = cell as usize;
                let cost = costs[cell];
                // Entered several times, by better and better ways.
                if std::mem::replace(&mut settled[cell], true) {
                    continue;
                }
                for (next, step) in self.steps(cell) {
                    let cost = cost.saturating_add(step);
                    if cost < costs[next] {
                        costs[next] = cost;
                        let to = (cost / UNIT % buckets.len() as u32) as usize;
                        buckets[to].push(next as u32);
                        waiting += 1;
                    }
                }
            }
            buckets[slot].append(&mut bucket);
            level += 1;
            if !search_all {
                open.retain(|g| costs[*g] / UNIT >= level);
                if open.is_empty() {
                    break;
                }
            }
        }
        costs
    }

    /// A cheapest way from `from` to `to`, both included, and its cost (A*); `None` if there is none or it would take more than
    /// `max_expansions` cells. Of equally good cells the one with the smaller index comes first.
    pub fn path(&self, from: usize, to: usize, max_expansions: usize) -> Option<(Vec<usize>, u32)> {
        if !self.is_passable(from) || !self.is_passable(to) {
            return None;
        }
        let goal = self.coordinates(to);
        let bound = |cell: usize| {
            let c = self.coordinates(cell);
            let mut d = [0, 1, 2].map(|a| c[a].abs_diff(goal[a]) as u32);
            d.sort_unstable();
            STEP[3] * d[0] + STEP[2] * (d[1] - d[0]) + STEP[1] * (d[2] - d[1])
        };
        let mut costs = vec![UNREACHED; self.cells.len()];
        let mut parents = vec![u32::MAX; self.cells.len()];
        let mut heap = BinaryHeap::new();
        costs[from] = 0;
        // Of equal sums the one nearer to the goal first: fewer expansions.
        heap.push(Reverse((u64::from(bound(from)), bound(from), from)));
        let mut expansions = 0;
        while let Some(Reverse((sum, rest, cell))) = heap.pop() {
            if sum != u64::from(costs[cell]) + u64::from(rest) {
                continue;
            }
            if cell == to {
                let mut path = vec![to];
                let mut at = to;
                while at != from {
                    at = parents[at] as usize;
                    path.push(at);
                }
                path.reverse();
                return Some((path, costs[to]));
            }
            expansions += 1;
            if expansions > max_expansions {
                return None;
            }
            let cost = costs[cell];
            for (next, step) in self.steps(cell) {
                let cost = cost.saturating_add(step);
                if cost < costs[next] {
                    costs[next] = cost;
                    parents[next] = cell as u32;
                    let rest = bound(next);
                    heap.push(Reverse((u64::from(cost) + u64::from(rest), rest, next)));
                }
            }
        }
        None
    }

    /// Which cells can be reached from `from`.
    pub fn flood(&self, from: usize) -> Vec<bool> {
        let mut reached = vec![false; self.cells.len()];
        if !self.is_passable(from) {
            return reached;
        }
        let (nx, ny) = (self.dims[0], self.dims[1]);
        let mut queue = vec![from as u32];
        reached[from] = true;
        while let Some(cell) = queue.pop() {
            let cell = cell as usize;
            // Diagonal steps need the straight ones around them: six neighbours reach the same cells.
            for next in [
                cell - 1,
                cell + 1,
                cell - nx,
                cell + nx,
                cell - nx * ny,
                cell + nx * ny,
            ] {
                if self.cells[next] != BLOCKED && !reached[next] {
                    reached[next] = true;
                    queue.push(next as u32);
                }
            }
        }
        reached
    }
}
