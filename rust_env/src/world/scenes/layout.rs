//! A room being furnished: what stands where, what must stay free, and the mesh of it all.
use super::clutter;
use super::draw::{Draw, Random};
use super::footprint::{border_distance, contains, edges, Block, Footprint};
use super::solid;
use super::walkways::Doorway;
use crate::geometry::{Mesh, Vec3};
use glam::Vec2;
use std::f32::consts::FRAC_PI_2;

/// What a surface is for; decides which things are put on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Use {
    Dining,
    Coffee,
    Desk,
    Shelf,
    Bedside,
    Counter,
    Cupboard,
    Goods,
    Pallet,
    Seat,
    Bathroom,
}

/// A horizontal rectangle on which things are put, in the frame of its piece.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    pub footprint: Footprint,
    pub z: f32,
    /// Free height above it.
    pub headroom: f32,
    pub usage: Use,
}

/// A piece of furniture or a thing in its own frame: origin on the floor in the middle of its footprint,
/// width along x, front towards +y (the back goes to the wall).
#[derive(Clone, Debug, Default)]
pub(super) struct Piece {
    pub mesh: Mesh,
    pub blocks: Vec<Block>,
    pub surfaces: Vec<Surface>,
    /// Half width and half depth.
    pub half: Vec2,
    pub height: f32,
    /// May be pushed under a table (chairs).
    pub tucks: bool,
    /// Depth of the strip in front of it that no other piece may take.
    pub front: f32,
}

impl Piece {
    /// A piece that fills the whole box `width x depth x height`.
    pub fn new(width: f32, depth: f32, height: f32) -> Self {
        let mut piece = Self::hollow(width, depth, height);
        piece.block(
            Vec3::new(-width / 2.0, -depth / 2.0, 0.0),
            Vec3::new(width / 2.0, depth / 2.0, height),
        );
        piece
    }

    /// A piece whose filled parts are named one by one with `block` or `part`.
    pub fn hollow(width: f32, depth: f32, height: f32) -> Self {
        Self {
            half: Vec2::new(width, depth) / 2.0,
            height,
            ..Self::default()
        }
    }

    pub fn block(&mut self, min: Vec3, max: Vec3) {
        let (center, half) = ((min + max) * 0.5, (max - min) * 0.5);
        self.blocks.push(Block::new(
            center.truncate(),
            half.truncate(),
            0.0,
            [min.z, max.z],
        ));
    }

    pub fn cuboid(&mut self, min: impl Into<Vec3>, max: impl Into<Vec3>) {
        solid::cuboid(&mut self.mesh, min.into(), max.into());
    }

    /// A visible box that also fills its place.
    pub fn part(&mut self, min: impl Into<Vec3>, max: impl Into<Vec3>) {
        let (min, max) = (min.into(), max.into());
        self.cuboid(min, max);
        self.block(min, max);
    }

    pub fn surface(&mut self, min: Vec2, max: Vec2, z: f32, headroom: f32, usage: Use) {
        self.surfaces.push(Surface {
            footprint: Footprint::new((min + max) / 2.0, (max - min) / 2.0, 0.0),
            z,
            headroom,
            usage,
        });
    }

    /// The whole top is a surface, but for `margin` at its edges.
    pub fn top(&mut self, margin: f32, z: f32, usage: Use) {
        let h = self.half - margin;
        self.surface(-h, h, z, 0.6, usage);
    }
}

/// Where a piece went: enough to put other pieces relative to it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub at: Vec2,
    pub yaw: f32,
    pub half: Vec2,
}

impl Placed {
    /// A point given in the piece's frame.
    pub fn point(&self, local: Vec2) -> Vec2 {
        self.at + Vec2::from_angle(self.yaw).rotate(local)
    }
}

/// A piece in its room.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kept {
    /// Its first block in `solid`.
    pub first: usize,
    /// Its number among the room's instances.
    pub instance: u32,
    /// The piece that it stands on; itself for one that stands on the floor or hangs.
    pub root: usize,
    /// Of a door.
    pub is_leaf: bool,
}

/// A surface of a piece that was put, in the room's frame, and what may be in the way there.
pub(super) struct Spot<'a> {
    pub surface: Surface,
    pub yaw: f32,
    /// First block of the piece that carries the surface.
    pub since: usize,
    /// Blocks of other pieces over the same floor.
    pub near: &'a [Block],
}

impl Spot<'_> {
    /// A point of the surface from its coordinates along and across it.
    pub fn point(&self, local: Vec2) -> Vec2 {
        let f = &self.surface.footprint;
        f.center + f.axis.rotate(local)
    }
}

/// One room: its inner outline and everything put into it so far.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    /// Inner floor outline, counter-clockwise.
    pub outline: Vec<Vec2>,
    pub floor: f32,
    /// Height of the walls above the floor.
    pub height: f32,
    pub ceiling: bool,
    pub mesh: Mesh,
    /// The instance of each triangle of the mesh, counted from 1.
    pub objects: Vec<u32>,
    /// What is filled. Heights are above the floor, as everywhere in a layout.
    pub solid: Vec<Block>,
    /// In the order of their blocks.
    pub pieces: Vec<Kept>,
    /// What people come in by.
    pub doorways: Vec<Doorway>,
    /// What must stay free (in front of doors, windows and cupboards).
    pub reserved: Vec<Block>,
    /// Discs that stay free from the floor up: (center, radius).
    pub clear: Vec<(Vec2, f32)>,
    pub instances: usize,
    /// Floor area under the pieces put so far, square metres.
    pub covered: f32,
    /// 0 = bare, 1 = every surface full.
    pub fullness: f32,
    /// Tessellation of round things, points per turn.
    pub segments: u32,
}

impl Layout {
    pub fn new(outline: Vec<Vec2>, floor: f32, height: f32) -> Self {
        Self {
            outline,
            floor,
            height,
            ceiling: false,
            mesh: Mesh::default(),
            objects: Vec::new(),
            solid: Vec::new(),
            pieces: Vec::new(),
            doorways: Vec::new(),
            reserved: Vec::new(),
            clear: Vec::new(),
            instances: 0,
            covered: 0.0,
            fullness: 0.6,
            segments: 12,
        }
    }

    /// Are the blocks inside the room, apart from the filled ones `near` and out of what must stay free?
    fn fits(&self, blocks: &[Block], near: &[Block]) -> bool {
        blocks.iter().all(|b| {
            b.z[1] <= self.height
                && !near.iter().any(|s| s.overlaps(b))
                && !self.reserved.iter().any(|r| r.overlaps(b))
                && self.keeps_clear(b)
                && self.inside(&b.footprint)
        })
    }

    /// Is the block out of all discs that stay free (or above the space that a camera needs)?
    fn keeps_clear(&self, b: &Block) -> bool {
        let hits = |(c, r): &(Vec2, f32)| b.footprint.distance(*c) < *r;
        b.z[0] >= 2.2 || !self.clear.iter().any(hits)
    }

    fn inside(&self, f: &Footprint) -> bool {
        let grown = f.grown(-1e-3);
        grown.corners().iter().all(|c| contains(&self.outline, *c))
            && !self.outline.iter().any(|p| grown.distance(*p) <= 0.0)
    }

    /// Puts the piece there if it fits; things for its surfaces come along.
    pub fn put(
        &mut self,
        piece: &Piece,
        at: Vec2,
        yaw: f32,
        lift: f32,
        random: &mut Random,
    ) -> Option<Placed> {
        let turn = Vec2::from_angle(yaw);
        let moved: Vec<Block> = piece
            .blocks
            .iter()
            .map(|b| b.moved(turn, at, lift))
            .collect();
        // Only what stands, hangs or lies over the same floor can be in the way, also of things put on the piece.
        let here = Footprint::new(at, piece.half + 0.02, yaw);
        let over = |s: &&Block| s.footprint.overlaps(&here, 0.0);
        let near: Vec<Block> = self.solid.iter().filter(over).copied().collect();
        // Furniture stands beside furniture, not under its overhang; bins, boxes and chairs may.
        let column = Block::new(at, piece.half, yaw, [0.0, piece.height.max(1.0)]);
        let is_low = piece.height < 0.45 && piece.surfaces.is_empty();
        let column = (lift == 0.0 && !piece.tucks && !is_low).then_some(column);
        if column.is_some_and(|c| near.iter().any(|s| s.overlaps(&c)) || !self.keeps_clear(&c))
            || !self.fits(&moved, &near)
        {
            return None;
        }
        let front = Block::new(
            at + turn.rotate(Vec2::new(0.0, piece.half.y + piece.front / 2.0)),
            Vec2::new(piece.half.x * 0.8, piece.front / 2.0),
            yaw,
            [0.0, piece.height.max(0.5)],
        );
        if piece.front > 0.0 && self.solid.iter().any(|s| s.overlaps(&front)) {
            return None;
        }
        let (first, root) = (self.solid.len(), self.pieces.len());
        self.keep(piece, moved, at, yaw, lift);
        if lift == 0.0 {
            self.covered += 4.0 * piece.half.x * piece.half.y;
        }
        if piece.front > 0.0 {
            self.reserved.push(front);
        }
        for s in &piece.surfaces {
            let surface = Surface {
                footprint: s.footprint.moved(turn, at),
                z: s.z + lift,
                ..*s
            };
            let spot = Spot {
                surface,
                yaw,
                since: first,
                near: &near,
            };
            clutter::dress(self, &spot, random);
        }
        self.pieces[root..].iter_mut().for_each(|k| k.root = root);
        Some(Placed {
            at,
            yaw,
            half: piece.half,
        })
    }

    /// Puts a thing on a surface, `lift` above it, turned by `turn` against the piece below; `at` in the room.
    pub fn put_on(&mut self, piece: &Piece, spot: &Spot, at: Vec2, turn: f32, lift: f32) -> bool {
        let (yaw, z) = (spot.yaw + turn, spot.surface.z + lift);
        let axis = Vec2::from_angle(yaw);
        let moved: Vec<Block> = piece.blocks.iter().map(|b| b.moved(axis, at, z)).collect();
        let others = || spot.near.iter().chain(&self.solid[spot.since..]);
        let is_free = !moved.iter().any(|b| others().any(|s| s.overlaps(b)));
        if is_free {
            self.keep(piece, moved, at, yaw, z);
        }
        is_free
    }

    fn keep(&mut self, piece: &Piece, blocks: Vec<Block>, at: Vec2, yaw: f32, lift: f32) {
        self.draw(&piece.mesh, at, yaw, lift);
        self.note(false);
        self.solid.extend(blocks);
    }

    /// Notes the instance that was drawn last as a piece whose blocks are put next.
    pub fn note(&mut self, is_leaf: bool) {
        self.pieces.push(Kept {
            first: self.solid.len(),
            instance: self.instances as u32,
            root: self.pieces.len(),
            is_leaf,
        });
    }

    /// Behind the last block of a piece.
    pub fn end_of(&self, piece: usize) -> usize {
        let next = self.pieces.get(piece + 1);
        next.map_or(self.solid.len(), |kept| kept.first)
    }

    /// The piece that a block belongs to.
    #[cfg(test)]
    pub fn owner(&self, block: usize) -> usize {
        self.pieces.partition_point(|kept| kept.first <= block)
    }

    /// Adds the mesh of one instance without filling anything (rugs).
    pub fn draw(&mut self, mesh: &Mesh, at: Vec2, yaw: f32, lift: f32) {
        self.instances += 1;
        let number = self.instances as u32;
        self.objects.extend(mesh.triangles.iter().map(|_| number));
        let turn = Vec2::from_angle(yaw);
        let base = self.mesh.vertices.len() as u32;
        let z = self.floor + lift;
        self.mesh.vertices.extend(
            mesh.vertices
                .iter()
                .map(|v| (turn.rotate(v.truncate()) + at).extend(v.z + z)),
        );
        self.mesh
            .triangles
            .extend(mesh.triangles.iter().map(|t| t.map(|i| i + base)));
    }

    /// Against a wall (every second time into a corner), back to the wall; `lift` for things that hang.
    pub fn against_wall(
        &mut self,
        piece: &Piece,
        lift: f32,
        tries: usize,
        random: &mut Random,
    ) -> Option<Placed> {
        let walls: Vec<(Vec2, Vec2)> = edges(&self.outline).collect();
        let lengths: Vec<f32> = walls.iter().map(|(a, b)| a.distance(*b)).collect();
        (0..tries).find_map(|_| {
            let (a, b) = walls[random.weighted(&lengths)];
            let along = (b - a).normalize_or(Vec2::X);
            let slack = a.distance(b) - 2.0 * piece.half.x;
            if slack < 0.04 {
                return None;
            }
            let gap = random.between(0.02, 0.08);
            let s = match random.count(0, 3) {
                0 => gap.min(slack),
                1 => (slack - gap).max(0.0),
                _ => random.between(0.0, slack),
            };
            // Wall-hung things touch the wall; furniture keeps a few centimetres.
            let off = if lift > 0.0 {
                0.002
            } else {
                random.between(0.01, 0.06)
            };
            let at = a + along * (s + piece.half.x) + along.perp() * (piece.half.y + off);
            self.put(piece, at, along.to_angle(), lift, random)
        })
    }

    /// Anywhere; `yaw` is square to a wall in two cases of three.
    pub fn anywhere(&mut self, piece: &Piece, tries: usize, random: &mut Random) -> Option<Placed> {
        (0..tries).find_map(|_| {
            let at = self.point(random);
            let yaw = self.any_yaw(random);
            self.put(piece, at, yaw, 0.0, random)
        })
    }

    pub fn any_yaw(&self, random: &mut Random) -> f32 {
        let (a, b) = (self.outline[0], self.outline[1]);
        let square = (b - a).to_angle() + FRAC_PI_2 * random.count(0, 3) as f32;
        if random.chance(0.67) {
            square + random.between(-0.06, 0.06)
        } else {
            random.heading()
        }
    }

    /// A point of the floor.
    pub fn point(&self, random: &mut Random) -> Vec2 {
        let min = self.outline.iter().fold(Vec2::INFINITY, |m, p| m.min(*p));
        let max = self
            .outline
            .iter()
            .fold(Vec2::NEG_INFINITY, |m, p| m.max(*p));
        let mut p = (min + max) / 2.0;
        for _ in 0..20 {
            p = Vec2::new(random.between(min.x, max.x), random.between(min.y, max.y));
            if contains(&self.outline, p) {
                break;
            }
        }
        p
    }

    /// Horizontal distance from the point to walls and distance in space to everything filled; `z` above the floor.
    pub fn clearance(&self, p: Vec2, z: f32) -> f32 {
        if !contains(&self.outline, p) {
            return 0.0;
        }
        let walls = border_distance(&self.outline, p);
        self.solid
            .iter()
            .map(|b| b.distance(p, z))
            .fold(walls, f32::min)
    }

    /// Is the clearance at least `need`? Much cheaper than the clearance.
    pub fn is_clear(&self, p: Vec2, z: f32, need: f32) -> bool {
        contains(&self.outline, p)
            && border_distance(&self.outline, p) >= need
            && !self.solid.iter().any(|b| {
                b.z[0] - z < need
                    && z - b.z[1] < need
                    && b.footprint.is_near(p, need)
                    && b.distance(p, z) < need
            })
    }
}
