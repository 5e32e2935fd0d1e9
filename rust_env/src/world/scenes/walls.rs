//! Walls with thickness, cut by doors, windows and passages.
use super::draw::{Draw, Random};
use super::fixtures;
use super::footprint::Block;
use super::layout::Layout;
use super::solid;
use crate::geometry::{Mesh, Vec3};
use glam::Vec2;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OpeningKind {
    /// With a leaf, more or less open.
    Door,
    /// A hole down to the floor.
    Passage,
    Window,
}

/// A hole in a wall; heights above the floor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Opening {
    pub kind: OpeningKind,
    /// Middle of the opening, metres from the start of the wall.
    pub at: f32,
    pub width: f32,
    pub sill: f32,
    pub top: f32,
}

impl Opening {
    pub fn door(at: f32, random: &mut Random) -> Self {
        Self {
            kind: OpeningKind::Door,
            at,
            width: random.between(0.8, 1.05),
            sill: 0.0,
            top: random.between(2.0, 2.15),
        }
    }

    pub fn passage(at: f32, width: f32, top: f32) -> Self {
        Self {
            kind: OpeningKind::Passage,
            at,
            width,
            sill: 0.0,
            top,
        }
    }

    pub fn window(at: f32, width: f32, random: &mut Random) -> Self {
        let sill = random.between(0.75, 1.0);
        Self {
            kind: OpeningKind::Window,
            at,
            width,
            sill,
            top: (sill + random.between(0.9, 1.5)).min(2.25),
        }
    }

    fn span(&self) -> [f32; 2] {
        [self.at - self.width / 2.0, self.at + self.width / 2.0]
    }

    /// Does it keep 0.25 m distance to all others on the wall?
    pub fn is_apart(&self, others: &[Opening]) -> bool {
        others
            .iter()
            .all(|o| (o.at - self.at).abs() > (o.width + self.width) / 2.0 + 0.25)
    }
}

/// The wall between the corners `inner` (start, end; the room is on the left) and `outer`, cut by `openings`.
/// Floor at `floor`, `height` above it.
pub(super) fn wall(
    mesh: &mut Mesh,
    inner: [Vec2; 2],
    outer: [Vec2; 2],
    floor: f32,
    height: f32,
    openings: &[Opening],
) {
    let length = inner[0].distance(inner[1]);
    let along = (inner[1] - inner[0]).normalize_or(Vec2::X);
    let thickness = (inner[0] - outer[0]).dot(along.perp());
    let at = |s: f32| -> [Vec2; 2] {
        let p = inner[0] + along * s;
        // The ends follow the mitred corners, cuts are square.
        if s <= 0.0 {
            [inner[0], outer[0]]
        } else if s >= length {
            [inner[1], outer[1]]
        } else {
            [p, p - along.perp() * thickness]
        }
    };
    let mut piece = |from: f32, to: f32, z0: f32, z1: f32| {
        if to - from > 1e-3 && z1 - z0 > 1e-3 {
            let ([a, d], [b, c]) = (at(from), at(to));
            solid::prism(mesh, &[d, c, b, a], floor + z0, floor + z1);
        }
    };
    let mut sorted = openings.to_vec();
    sorted.sort_by(|a, b| a.at.total_cmp(&b.at));
    let mut done = 0.0;
    for opening in &sorted {
        let [from, to] = opening.span();
        piece(done, from, 0.0, height);
        piece(from, to, 0.0, opening.sill);
        piece(from, to, opening.top.min(height), height);
        done = to;
    }
    piece(done, length, 0.0, height);
}

/// Keeps the room in front of an opening free, and hangs the door leaf or the window sill.
/// `a -> b` is the wall's inner line (room on the left); `hangs_here` = the leaf opens into this room.
pub(super) fn fit_opening(
    layout: &mut Layout,
    [a, b]: [Vec2; 2],
    opening: &Opening,
    hangs_here: bool,
    random: &mut Random,
) {
    let along = (b - a).normalize_or(Vec2::X);
    let inward = along.perp();
    let yaw = along.to_angle();
    let middle = a + along * opening.at;
    match opening.kind {
        OpeningKind::Window => {
            layout.reserved.push(Block::new(
                middle + inward * 0.15,
                Vec2::new(opening.width / 2.0, 0.15),
                yaw,
                [opening.sill, opening.top],
            ));
            if random.chance(0.35) {
                let curtain = fixtures::curtain(random, opening.top + 0.1);
                for side in [-1.0f32, 1.0] {
                    let out = side * (opening.width / 2.0 + curtain.half.x + 0.01);
                    let at = middle + along * out + inward * (curtain.half.y + 0.01);
                    layout.put(&curtain, at, yaw, 0.01, random);
                }
            }
        }
        OpeningKind::Passage | OpeningKind::Door => {
            let depth = if opening.kind == OpeningKind::Door {
                opening.width + 0.1
            } else {
                0.8
            };
            let free = Block::new(
                middle + inward * (depth / 2.0),
                Vec2::new(opening.width / 2.0 + 0.05, depth / 2.0),
                yaw,
                [0.0, opening.top],
            );
            if opening.kind == OpeningKind::Door && hangs_here {
                hang_leaf(layout, middle, along, opening, random);
            }
            layout.reserved.push(free);
        }
    }
}

/// The leaf, hinged at one jamb: closed in one case of five, else anything from ajar to wide open.
fn hang_leaf(
    layout: &mut Layout,
    middle: Vec2,
    along: Vec2,
    opening: &Opening,
    random: &mut Random,
) {
    const THICKNESS: f32 = 0.04;
    let side = random.one_of(&[-1.0f32, 1.0]);
    let hinge = middle + along * (side * (opening.width / 2.0 - 0.01));
    let angle = if random.chance(0.2) {
        0.0
    } else {
        random.between(0.35, 1.65)
    };
    // Closed, the leaf points from the hinge to the other jamb; it swings into the room.
    let direction = Vec2::from_angle(-side * angle).rotate(along * -side);
    let width = opening.width - 0.02;
    let off = along.perp() * (THICKNESS / 2.0 + 0.005);
    let center = hinge + direction * (width / 2.0) + off;
    let yaw = direction.to_angle();
    let mut mesh = Mesh::default();
    let half = Vec3::new(width / 2.0, THICKNESS / 2.0, opening.top / 2.0 - 0.01);
    solid::turned_cuboid(&mut mesh, Vec3::new(0.0, 0.0, opening.top / 2.0), half, 0.0);
    for y in [-1.0, 1.0] {
        let handle = Vec3::new(width / 2.0 - 0.08, y * (THICKNESS / 2.0 + 0.025), 1.05);
        solid::turned_cuboid(&mut mesh, handle, Vec3::new(0.06, 0.012, 0.012), 0.0);
    }
    let block = Block::new(
        center,
        Vec2::new(half.x, half.y + 0.04),
        yaw,
        [0.0, opening.top],
    );
    // Two leaves in one corner would cut each other: this one was taken off its hinges.
    if !layout.solid.iter().any(|s| s.overlaps(&block)) {
        layout.draw(&mesh, center, yaw, 0.0);
        layout.instances += 1;
        layout.pieces.push(layout.solid.len());
        layout.solid.push(block);
    }
}
