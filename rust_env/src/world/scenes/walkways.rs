//! The ways through a furnished room: whoever comes in by one door gets to all others and to every large part of the floor.
//! Pieces that stand in the way are taken out, as few and as small ones as possible; nothing is drawn at random for it.
use super::footprint::{edges, Block};
use super::layout::{Kept, Layout};
use glam::Vec2;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Side of a cell, metres.
const CELL: f32 = 0.05;
/// Half the width of a way, metres: a body of 0.4 m gets through with room to spare, also by steps on another lattice.
const HALF_WIDTH: f32 = 0.29;
/// The same beside the leaf of a door, whose block counts its handles in, and beside the jambs: a leaf that is half open
/// leaves no more.
const IN_DOORWAY: f32 = 0.25;
/// What lies lower is stepped or flown over, what hangs higher is passed under, metres above the floor.
const LOW: f32 = 0.3;
const HIGH: f32 = 1.8;
/// Parts of the floor that are smaller may be shut off by furniture, square metres.
const NOOK: f32 = 0.6;
/// What a step into the way of a piece costs, in free steps: for any piece, for each square metre of it, and for a leaf.
const PIECE_COST: f32 = 40.0;
const AREA_COST: f32 = 200.0;
const LEAF_COST: f32 = 400.0;

/// The inside of an opening in a room's wall that people go through.
#[derive(Clone, Copy, Debug)]
pub(super) struct Doorway {
    /// The middle of its threshold, at the wall's face.
    pub at: Vec2,
    pub inward: Vec2,
    pub width: f32,
}

/// Takes out what stands in the way.
pub(super) fn open_ways(layout: &mut Layout) {
    if layout.doorways.is_empty() {
        return;
    }
    let mut grid = Grid::new(layout);
    let mut gone = vec![false; layout.pieces.len()];
    let mut reached = vec![false; grid.floor.len()];
    let mut goals = layout.doorways.iter().map(|door| grid.doorway(door));
    let first = goals.next().unwrap_or_default();
    let mut goals: Vec<Vec<usize>> = goals.collect();
    first.into_iter().for_each(|cell| reached[cell] = true);
    loop {
        let from = (0..reached.len()).filter(|cell| reached[*cell]);
        let from = from.collect();
        grid.flood(&mut reached, from);
        goals.retain(|goal| !goal.iter().any(|cell| reached[*cell]));
        let Some(goal) = goals.pop().or_else(|| grid.part_without(&reached)) else {
            break;
        };
        // Where walls are in the way there is nothing to take out.
        let way = grid.cheapest_way(&reached, &goal);
        for cell in way.unwrap_or(goal) {
            reached[cell] = true;
            grid.take_out(cell, &mut gone);
        }
    }
    if gone.iter().any(|g| *g) {
        take_out(layout, &gone);
    }
}

/// What stands in the way of a piece's blocks.
struct Obstacle {
    block: Block,
    /// How near to it one cannot be.
    reach: f32,
    root: usize,
    cost: u32,
}

/// The floor of a room in cells.
struct Grid {
    low: Vec2,
    width: usize,
    /// Far enough from the walls, or between the jambs of a doorway.
    floor: Vec<bool>,
    /// Sum over the obstacles in the way.
    cost: Vec<u32>,
    obstacles: Vec<Obstacle>,
}

impl Grid {
    fn new(layout: &Layout) -> Self {
        let corners = || layout.outline.iter();
        let low = corners().fold(Vec2::INFINITY, |m, p| m.min(*p));
        let high = corners().fold(Vec2::NEG_INFINITY, |m, p| m.max(*p));
        let size = ((high - low) / CELL).ceil();
        let (width, height) = (size.x as usize + 1, size.y as usize + 1);
        let mut grid = Self {
            low,
            width,
            floor: Vec::new(),
            cost: vec![0; width * height],
            obstacles: Vec::new(),
        };
        // Rooms of plans are convex: far enough from all walls' lines is inside and far enough from all walls.
        let walls: Vec<(Vec2, Vec2)> = edges(&layout.outline)
            .map(|(a, b)| (a, (b - a).normalize_or_zero().perp()))
            .collect();
        let is_floor = |p: Vec2| {
            let depth = |(a, inward): &(Vec2, Vec2)| (p - *a).dot(*inward);
            walls.iter().all(|wall| depth(wall) >= HALF_WIDTH)
                || layout.doorways.iter().any(|d| d.depth(p).is_some())
        };
        grid.floor = (0..width * height)
            .map(|cell| is_floor(grid.at(cell)))
            .collect();
        // Square metres of the largest part of each piece.
        let mut place = vec![0.0f32; layout.pieces.len()];
        for (i, kept) in layout.pieces.iter().enumerate() {
            for block in &layout.solid[kept.first..layout.end_of(i)] {
                let half = block.footprint.half;
                place[i] = place[i].max(4.0 * half.x * half.y);
            }
        }
        for (i, kept) in layout.pieces.iter().enumerate() {
            let end = layout.end_of(i);
            let (reach, cost) = if layout.pieces[kept.root].is_leaf {
                (IN_DOORWAY, LEAF_COST)
            } else {
                (HALF_WIDTH, PIECE_COST + AREA_COST * place[kept.root])
            };
            for block in &layout.solid[kept.first..end] {
                if block.z[0] < HIGH && block.z[1] > LOW {
                    grid.put(Obstacle {
                        block: *block,
                        reach,
                        root: kept.root,
                        cost: cost as u32,
                    });
                }
            }
        }
        grid
    }

    fn at(&self, cell: usize) -> Vec2 {
        self.low + Vec2::new((cell % self.width) as f32, (cell / self.width) as f32) * CELL
    }

    fn put(&mut self, obstacle: Obstacle) {
        for cell in self.in_the_way(&obstacle) {
            self.cost[cell] += obstacle.cost;
        }
        self.obstacles.push(obstacle);
    }

    /// The cells where the obstacle is too near.
    fn in_the_way(&self, obstacle: &Obstacle) -> Vec<usize> {
        let footprint = &obstacle.block.footprint;
        let around = footprint.corners().map(|c| (c - self.low) / CELL);
        let reach = obstacle.reach / CELL;
        let low = around.iter().fold(Vec2::INFINITY, |m, c| m.min(*c)) - reach;
        let high = around.iter().fold(Vec2::NEG_INFINITY, |m, c| m.max(*c)) + reach;
        let top = Vec2::new(
            (self.width - 1) as f32,
            (self.cost.len() / self.width - 1) as f32,
        );
        let (low, high) = (low.ceil().max(Vec2::ZERO), high.floor().min(top));
        let mut cells = Vec::new();
        if low.cmple(high).all() {
            for y in low.y as usize..=high.y as usize {
                for x in low.x as usize..=high.x as usize {
                    let cell = y * self.width + x;
                    if self.floor[cell] && footprint.distance(self.at(cell)) < obstacle.reach {
                        cells.push(cell);
                    }
                }
            }
        }
        cells
    }

    /// The free cells on the threshold; all of them if none is free.
    fn doorway(&self, door: &Doorway) -> Vec<usize> {
        let is_on =
            |cell: &usize| self.floor[*cell] && door.depth(self.at(*cell)).is_some_and(|d| d < 0.1);
        let all: Vec<usize> = (0..self.floor.len()).filter(is_on).collect();
        let free: Vec<usize> = all.iter().copied().filter(|c| self.cost[*c] == 0).collect();
        if free.is_empty() {
            all
        } else {
            free
        }
    }

    /// The neighbours of a cell that are no walls.
    fn neighbours(&self, cell: usize) -> impl Iterator<Item = usize> + '_ {
        let x = cell % self.width;
        let beside = [
            (x > 0).then(|| cell - 1),
            (x + 1 < self.width).then_some(cell + 1),
            cell.checked_sub(self.width),
            Some(cell + self.width),
        ];
        let is_floor = |c: &usize| self.floor.get(*c) == Some(&true);
        beside.into_iter().flatten().filter(is_floor)
    }

    /// Adds all that can be reached from some cells without moving anything; returns it with these.
    fn flood(&self, reached: &mut [bool], mut todo: Vec<usize>) -> Vec<usize> {
        let mut next = 0;
        while let Some(cell) = todo.get(next).copied() {
            next += 1;
            for to in self.neighbours(cell) {
                if self.cost[to] == 0 && !reached[to] {
                    reached[to] = true;
                    todo.push(to);
                }
            }
        }
        todo
    }

    /// A free part of the floor that is no nook and that was not reached.
    fn part_without(&self, reached: &[bool]) -> Option<Vec<usize>> {
        let mut seen = reached.to_vec();
        for cell in 0..seen.len() {
            if seen[cell] || !self.floor[cell] || self.cost[cell] > 0 {
                continue;
            }
            seen[cell] = true;
            let part = self.flood(&mut seen, vec![cell]);
            if part.len() as f32 * CELL * CELL >= NOOK {
                return Some(part);
            }
        }
        None
    }

    /// From what is reached to the goal, past as little as possible.
    fn cheapest_way(&self, reached: &[bool], goal: &[usize]) -> Option<Vec<usize>> {
        let mut least = vec![u32::MAX; reached.len()];
        let mut from = vec![usize::MAX; reached.len()];
        let mut todo = BinaryHeap::new();
        for cell in (0..reached.len()).filter(|c| reached[*c]) {
            least[cell] = 0;
            todo.push(Reverse((0, cell)));
        }
        let mut is_goal = vec![false; reached.len()];
        goal.iter().for_each(|c| is_goal[*c] = true);
        while let Some(Reverse((cost, cell))) = todo.pop() {
            if is_goal[cell] {
                let mut way = vec![cell];
                while let Some(before) = way.last().map(|c| from[*c]).filter(|c| *c != usize::MAX) {
                    way.push(before);
                }
                return Some(way);
            }
            if cost > least[cell] {
                continue;
            }
            for to in self.neighbours(cell) {
                let there = cost + 1 + self.cost[to];
                if there < least[to] {
                    (least[to], from[to]) = (there, cell);
                    todo.push(Reverse((there, to)));
                }
            }
        }
        None
    }

    /// Takes out the pieces that are in the way at a cell.
    fn take_out(&mut self, cell: usize, gone: &mut [bool]) {
        if self.cost[cell] == 0 {
            return;
        }
        let p = self.at(cell);
        for o in &self.obstacles {
            gone[o.root] |= o.block.footprint.distance(p) < o.reach;
        }
        for obstacle in std::mem::take(&mut self.obstacles) {
            if gone[obstacle.root] {
                for cell in self.in_the_way(&obstacle) {
                    self.cost[cell] -= obstacle.cost;
                }
            } else {
                self.obstacles.push(obstacle);
            }
        }
    }
}

impl Doorway {
    /// Metres from the threshold into the room, as long as one is on it and not too near to the jambs.
    fn depth(&self, p: Vec2) -> Option<f32> {
        let d = p - self.at;
        let (depth, aside) = (d.dot(self.inward), d.perp_dot(self.inward).abs());
        let to_jamb = self.width / 2.0 - aside;
        let is_on = (0.0..=HALF_WIDTH).contains(&depth)
            && to_jamb > 0.0
            && to_jamb * to_jamb + depth * depth >= IN_DOORWAY * IN_DOORWAY;
        is_on.then_some(depth)
    }
}

/// Takes the pieces and what stands on them out of the room. `gone`: by their roots.
fn take_out(layout: &mut Layout, gone: &[bool]) {
    let is_gone = |i: usize| gone[layout.pieces[i].root];
    let mut instance_is_gone = vec![false; layout.instances + 1];
    let mut number = vec![usize::MAX; layout.pieces.len()];
    let (mut pieces, mut solid) = (Vec::new(), Vec::new());
    for (i, kept) in layout.pieces.iter().enumerate() {
        if is_gone(i) {
            instance_is_gone[kept.instance as usize] = true;
            continue;
        }
        number[i] = pieces.len();
        let end = layout.end_of(i);
        pieces.push(Kept {
            first: solid.len(),
            root: number[kept.root],
            ..*kept
        });
        solid.extend_from_slice(&layout.solid[kept.first..end]);
    }
    // Instances are counted without gaps.
    let mut left = 0;
    let renumbered: Vec<u32> = instance_is_gone
        .iter()
        .map(|gone| {
            let number = left;
            left += u32::from(!gone);
            number
        })
        .collect();
    for kept in &mut pieces {
        kept.instance = renumbered[kept.instance as usize];
    }
    let old = std::mem::take(&mut layout.mesh);
    let objects = std::mem::take(&mut layout.objects);
    let stays = |object: &u32| !instance_is_gone[*object as usize];
    let triangles = old.triangles.iter().zip(&objects);
    let triangles = triangles.filter(|(_, object)| stays(object));
    let mut moved = vec![0; old.vertices.len()];
    for (triangle, _) in triangles.clone() {
        triangle.iter().for_each(|i| moved[*i as usize] = 1);
    }
    let mesh = &mut layout.mesh;
    for (vertex, to) in old.vertices.iter().zip(&mut moved) {
        if *to == 1 {
            *to = mesh.vertices.len() as u32;
            mesh.vertices.push(*vertex);
        }
    }
    for (triangle, object) in triangles {
        mesh.triangles.push(triangle.map(|i| moved[i as usize]));
        layout.objects.push(renumbered[*object as usize]);
    }
    layout.instances = left as usize - 1;
    (layout.pieces, layout.solid) = (pieces, solid);
}

#[cfg(test)]
mod tests;
