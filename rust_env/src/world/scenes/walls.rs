//! Walls with thickness, cut by doors, windows and passages.
use super::draw::{Draw, Random};
use super::fixtures;
use super::footprint::Block;
use super::layout::Layout;
use super::solid;
use crate::geometry::{Mesh, Vec3};
use glam::Vec2;

/// A leaf of 0.8 m that stands open this far, radians, leaves 0.65 m.
const HALF_OPEN: f32 = 0.85;

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
    /// How far a door's leaf stands open, radians: 0 is closed.
    pub ajar: f32,
}

impl Opening {
    /// A door to the outside: closed in one case of five, else anything from ajar to wide open.
    pub fn door(at: f32, random: &mut Random) -> Self {
        let closed = random.chance(0.2);
        let ajar = if closed {
            0.0
        } else {
            random.between(0.35, 1.65)
        };
        Self {
            kind: OpeningKind::Door,
            at,
            width: random.between(0.8, 1.05),
            sill: 0.0,
            top: random.between(2.0, 2.15),
            ajar,
        }
    }

    /// A door between rooms: at least half open, so that a body of 0.5 m gets through.
    pub fn inner_door(at: f32, random: &mut Random) -> Self {
        Self {
            ajar: random.between(HALF_OPEN, 1.65),
            ..Self::door(at, random)
        }
    }

    pub fn passage(at: f32, width: f32, top: f32) -> Self {
        Self {
            kind: OpeningKind::Passage,
            at,
            width,
            sill: 0.0,
            top,
            ajar: 0.0,
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
            ajar: 0.0,
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

/// Keeps the room in front of an opening free, and hangs curtains.
/// `a -> b` is the wall's inner line (room on the left).
pub(super) fn fit_opening(
    layout: &mut Layout,
    [a, b]: [Vec2; 2],
    opening: &Opening,
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
            layout.reserved.push(in_front([a, b], opening));
        }
    }
}

/// What must stay free in front of a door or passage.
fn in_front([a, b]: [Vec2; 2], opening: &Opening) -> Block {
    let along = (b - a).normalize_or(Vec2::X);
    let depth = match opening.kind {
        OpeningKind::Door => opening.width + 0.1,
        _ => 0.8,
    };
    Block::new(
        a + along * opening.at + along.perp() * (depth / 2.0),
        Vec2::new(opening.width / 2.0 + 0.05, depth / 2.0),
        along.to_angle(),
        [0.0, opening.top],
    )
}

/// The leaf of a door into the room on the left of `line`, once all openings of the room are fitted: it must not stand in
/// another one's way. Hinged at a jamb on the room's side of the wall; like a real one it overlaps jambs and lintel: no slits.
pub(super) fn hang_leaf(
    layout: &mut Layout,
    line: [Vec2; 2],
    opening: &Opening,
    random: &mut Random,
) {
    if opening.kind != OpeningKind::Door {
        return;
    }
    let own = in_front(line, opening);
    let first = random.one_of(&[-1.0f32, 1.0]);
    for side in [first, -first] {
        if try_leaf(layout, line, opening, side, &own) {
            return;
        }
    }
    // A leaf that would cut another one or block another door was taken off its hinges.
}

/// With the hinge at the jamb on that side of the opening; false if it stands in the way.
fn try_leaf(
    layout: &mut Layout,
    [a, b]: [Vec2; 2],
    opening: &Opening,
    side: f32,
    own: &Block,
) -> bool {
    const THICKNESS: f32 = 0.04;
    const OVERLAP: f32 = 0.02;
    let along = (b - a).normalize_or(Vec2::X);
    let hinge = a + along * (opening.at + side * opening.width / 2.0);
    // Closed, the leaf points from the hinge to the other jamb and lies on the wall; it turns into the room as one body.
    let turn = Vec2::from_angle(-side * opening.ajar);
    let direction = turn.rotate(along * -side);
    let into_room = turn.rotate(along.perp());
    let width = opening.width + 2.0 * OVERLAP;
    let center = hinge + direction * (width / 2.0 - OVERLAP) + into_room * (THICKNESS / 2.0);
    let yaw = direction.to_angle();
    let mut mesh = Mesh::default();
    let tall = opening.top + OVERLAP;
    let half = Vec3::new(width / 2.0, THICKNESS / 2.0, tall / 2.0);
    solid::turned_cuboid(&mut mesh, Vec3::new(0.0, 0.0, tall / 2.0), half, 0.0);
    for y in [-1.0, 1.0] {
        let handle = Vec3::new(width / 2.0 - 0.08, y * (THICKNESS / 2.0 + 0.025), 1.05);
        solid::turned_cuboid(&mut mesh, handle, Vec3::new(0.06, 0.012, 0.012), 0.0);
    }
    let block = Block::new(center, Vec2::new(half.x, half.y + 0.04), yaw, [0.0, tall]);
    let others = layout
        .reserved
        .iter()
        .filter(|r| r.footprint.center.distance(own.footprint.center) > 1e-3 && r.z[0] < 0.5);
    if layout
        .solid
        .iter()
        .chain(others)
        .any(|s| s.overlaps(&block))
    {
        return false;
    }
    layout.draw(&mesh, center, yaw, 0.0);
    layout.note(true);
    layout.solid.push(block);
    true
}
