//! Parametric fittings: kitchen, lamps, plants, radiators, things on the wall and on the floor.
use super::crockery;
use super::draw::{Draw, Random};
use super::layout::{Piece, Use};
use super::objects;
use super::solid::{self, Ring};
use crate::geometry::Vec3;
use glam::Vec2;
use std::f32::consts::{PI, TAU};

pub(super) fn v(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3::new(x, y, z)
}

fn v2(x: f32, y: f32) -> Vec2 {
    Vec2::new(x, y)
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Unit {
    Plain,
    Sink,
    Stove,
}

/// One kitchen unit with a counter top at `height`; a sink is a real basin, a stove has hobs.
pub(super) fn counter(r: &mut Random, [width, depth, height]: [f32; 3], unit: Unit) -> Piece {
    let mut piece = Piece::new(width, depth, height);
    let (x, y, top) = (width / 2.0, depth / 2.0, height - 0.04);
    piece.cuboid(v(-x, -y, 0.0), v(x, y - 0.09, 0.1));
    let under = if unit == Unit::Sink { top - 0.18 } else { top };
    piece.cuboid(v(-x, -y, 0.1), v(x, y - 0.04, under));
    let fronts = if width > 0.7 { 2 } else { 1 };
    let fw = width / fronts as f32;
    for i in 0..fronts {
        let a = -x + fw * i as f32 + 0.003;
        piece.cuboid(
            v(a, y - 0.04, 0.11),
            v(a + fw - 0.006, y - 0.025, top - 0.01),
        );
        piece.cuboid(
            v(a + 0.06, y - 0.025, top - 0.07),
            v(a + fw - 0.06, y - 0.01, top - 0.06),
        );
    }
    match unit {
        Unit::Sink => {
            // The rim of the basin: four bars around the hole, walls below.
            let (bx, b0, b1) = (x - 0.1, -y + 0.14, y - 0.1);
            piece.cuboid(v(-x, -y, under), v(x, b0, height));
            piece.cuboid(v(-x, b1, under), v(x, y, height));
            piece.cuboid(v(-x, b0, under), v(-bx, b1, height));
            piece.cuboid(v(bx, b0, under), v(x, b1, height));
            let tap = v(0.0, -y + 0.08, height);
            solid::tube(&mut piece.mesh, tap, tap + Vec3::Z * 0.25, 0.014, 0.012, 8);
            let arc = Ring {
                center: tap + v(0.0, 0.07, 0.25),
                u: Vec3::Y,
                v: Vec3::Z,
                major: 0.07,
                minor: 0.011,
                from: 0.0,
                to: PI,
            };
            solid::ring(&mut piece.mesh, &arc, 6, 6);
            piece.block(
                v(-0.02, -y + 0.06, height),
                v(0.02, -y + 0.24, height + 0.34),
            );
        }
        Unit::Stove => {
            piece.cuboid(v(-x, -y, top), v(x, y, height));
            for (sx, sy) in [(-0.5, -0.4), (0.5, -0.4), (-0.5, 0.4), (0.5, 0.4)] {
                let at = v(sx * x, sy * y, height);
                let radius = r.between(0.07, 0.1);
                solid::cylinder(&mut piece.mesh, at, radius, 0.012, 12);
                if r.chance(0.2) {
                    let pot = crockery::pot(r, 12);
                    let base = piece.mesh.vertices.len();
                    piece.mesh.append(&pot.mesh);
                    for p in &mut piece.mesh.vertices[base..] {
                        *p = *p * 0.8 + at + Vec3::Z * 0.012;
                    }
                }
            }
            piece.block(v(-x, -y, height), v(x, y, height + 0.2));
        }
        Unit::Plain => {
            piece.cuboid(v(-x, -y, top), v(x, y, height));
            piece.top(0.03, height, Use::Counter);
        }
    }
    piece
}

/// A fridge, washing machine or oven block: body, door with gap, handle.
pub(super) fn fridge(r: &mut Random) -> Piece {
    let (w, d, h) = (
        r.between(0.58, 0.92),
        r.between(0.6, 0.74),
        r.between(1.5, 1.95),
    );
    let mut piece = Piece::new(w, d, h);
    let (x, y) = (w / 2.0, d / 2.0);
    piece.cuboid(v(-x, -y, 0.04), v(x, y - 0.12, h));
    let split = h * r.between(0.35, 0.7);
    for (z0, z1) in [(0.06, split), (split + 0.01, h)] {
        piece.cuboid(v(-x, y - 0.11, z0), v(x, y - 0.04, z1));
        let mid = (z0 + z1) / 2.0;
        piece.cuboid(
            v(x - 0.08, y - 0.04, mid - 0.15),
            v(x - 0.05, y, mid + 0.15),
        );
    }
    piece.front = 0.5;
    piece
}

/// A cabinet or shelf to hang on the wall; its own z starts at 0, hang it with a lift.
pub(super) fn wall_cabinet(r: &mut Random, width: f32) -> Piece {
    let size = [width, r.between(0.28, 0.36), r.between(0.5, 0.75)];
    let columns = if width > 0.65 { 2 } else { 1 };
    let mut piece = super::furniture::cupboard(r, size, columns, 1);
    piece.surfaces.clear();
    piece.front = 0.0;
    piece
}

pub(super) fn wall_board(r: &mut Random) -> Piece {
    let (w, d) = (r.between(0.5, 1.2), r.between(0.16, 0.26));
    let mut piece = Piece::hollow(w, d, 0.3);
    let (x, y) = (w / 2.0, d / 2.0);
    piece.part(v(-x, -y, 0.0), v(x, y, 0.025));
    for s in [-0.7f32, 0.7] {
        piece.cuboid(v(s * x - 0.01, -y, -0.12), v(s * x + 0.01, -y + 0.02, 0.0));
    }
    piece.surface(v2(-x, -y + 0.01), v2(x, y), 0.025, 0.32, Use::Shelf);
    piece
}

/// A picture, mirror, whiteboard or notice board: frame and recessed panel.
pub(super) fn picture(r: &mut Random, width: f32, height: f32) -> Piece {
    let depth = r.between(0.02, 0.045);
    let mut piece = Piece::new(width, depth, height);
    let (x, y, rim) = (width / 2.0, depth / 2.0, r.between(0.015, 0.05));
    piece.cuboid(v(-x, -y, 0.0), v(x, y, rim));
    piece.cuboid(v(-x, -y, height - rim), v(x, y, height));
    piece.cuboid(v(-x, -y, rim), v(-x + rim, y, height - rim));
    piece.cuboid(v(x - rim, -y, rim), v(x, y, height - rim));
    piece.cuboid(v(-x + rim, -y, rim), v(x - rim, y * 0.3, height - rim));
    piece
}

/// A panel radiator with fins.
pub(super) fn radiator(r: &mut Random) -> Piece {
    let (w, h) = (r.between(0.6, 1.4), r.between(0.45, 0.62));
    let mut piece = Piece::new(w, 0.12, h);
    let (x, y) = (w / 2.0, 0.06);
    let fins = (w / 0.09) as usize;
    for i in 0..fins {
        let c = -x + w * (i as f32 + 0.5) / fins as f32;
        piece.cuboid(v(c - 0.028, -y + 0.02, 0.1), v(c + 0.028, y, h));
    }
    piece.cuboid(v(-x, -0.015, 0.12), v(x, 0.015, 0.16));
    piece.cuboid(v(-x, -0.015, h - 0.08), v(x, 0.015, h - 0.04));
    piece
}

/// A curtain drawn aside: a wavy sheet.
pub(super) fn curtain(r: &mut Random, height: f32) -> Piece {
    let w = r.between(0.25, 0.5);
    let mut piece = Piece::new(w, 0.09, height);
    let waves = r.count(3, 5) as f32;
    let steps = 24;
    let first = piece.mesh.vertices.len() as u32;
    for i in 0..=steps {
        let s = i as f32 / steps as f32;
        let p = v(w * (s - 0.5), 0.04 * (TAU * waves * s).sin(), 0.02);
        piece.mesh.vertices.extend([p, v(p.x, p.y, height)]);
    }
    for i in 0..steps {
        let a = first + 2 * i;
        piece.mesh.triangles.push([a, a + 2, a + 3]);
        piece.mesh.triangles.push([a, a + 3, a + 1]);
    }
    piece
}

pub(super) fn floor_lamp(r: &mut Random) -> Piece {
    let (h, shade) = (r.between(1.5, 1.9), r.between(0.16, 0.25));
    let mut piece = Piece::hollow(2.0 * shade, 2.0 * shade, h);
    let foot = shade * 0.75;
    solid::cylinder(&mut piece.mesh, Vec3::ZERO, foot, 0.025, 16);
    solid::cylinder(&mut piece.mesh, v(0.0, 0.0, 0.025), 0.013, h - 0.2, 8);
    objects::lamp_shade(
        &mut piece,
        h - 0.28,
        h,
        shade,
        shade * r.between(0.5, 0.9),
        16,
    );
    piece.block(v(-foot, -foot, 0.0), v(foot, foot, 0.03));
    piece.block(v(-0.03, -0.03, 0.03), v(0.03, 0.03, h - 0.28));
    piece.block(v(-shade, -shade, h - 0.28), v(shade, shade, h));
    piece
}

/// A lamp that hangs `drop` below the ceiling; its origin is the lower rim.
pub(super) fn hanging_lamp(r: &mut Random, drop: f32) -> Piece {
    let radius = r.between(0.12, 0.28);
    let tall = r.between(0.12, 0.22).min(drop * 0.8);
    let mut piece = Piece::new(2.0 * radius, 2.0 * radius, drop - 0.003);
    objects::lamp_shade(&mut piece, 0.0, tall, radius, radius * 0.35, 16);
    let (a, b) = (v(0.0, 0.0, tall * 0.7), v(0.0, 0.0, drop - 0.003));
    solid::tube(&mut piece.mesh, a, b, 0.006, 0.006, 5);
    piece
}

/// A large plant in a pot: stem with leaves, or a bushy crown.
pub(super) fn plant(r: &mut Random) -> Piece {
    let (pot, h) = (r.between(0.13, 0.22), r.between(0.7, 1.7));
    let reach = r.between(0.22, 0.4);
    let tall = pot * 1.7;
    let mut piece = Piece::hollow(2.0 * reach, 2.0 * reach, h);
    solid::vessel(
        &mut piece.mesh,
        Vec3::ZERO,
        [pot * 0.7, pot],
        tall,
        0.012,
        16,
    );
    solid::cylinder(
        &mut piece.mesh,
        v(0.0, 0.0, tall * 0.85),
        pot * 0.9,
        0.01,
        12,
    );
    let crown = tall + 0.25 * (h - tall);
    solid::tube(
        &mut piece.mesh,
        v(0.0, 0.0, tall * 0.85),
        v(0.0, 0.0, crown + 0.5 * (h - crown)),
        0.018,
        0.008,
        6,
    );
    if r.chance(0.6) {
        let count = r.count(16, 40);
        objects::leaves(&mut piece, crown, reach, h - crown, count, r);
    } else {
        let base = v(0.0, 0.0, crown);
        solid::lump(
            &mut piece.mesh,
            base,
            Vec2::splat(reach * 0.9),
            h - crown,
            0.35,
            14,
            r,
        );
    }
    piece.block(v(-pot, -pot, 0.0), v(pot, pot, tall));
    piece.block(v(-reach, -reach, tall), v(reach, reach, h));
    piece
}

pub(super) fn bin(r: &mut Random) -> Piece {
    let (radius, h) = (r.between(0.11, 0.2), r.between(0.25, 0.6));
    let mut piece = Piece::new(2.0 * radius, 2.0 * radius, h);
    solid::vessel(
        &mut piece.mesh,
        Vec3::ZERO,
        [radius * 0.8, radius],
        h,
        0.005,
        14,
    );
    if r.chance(0.3) {
        let lid = [
            (radius, h - 0.02),
            (radius * 0.9, h + 0.02),
            (0.0, h + 0.04),
        ];
        solid::revolve(&mut piece.mesh, Vec3::ZERO, &lid, 14);
        piece.height = h + 0.04;
        piece.block((-piece.half).extend(h), piece.half.extend(piece.height));
    }
    piece
}

pub(super) fn coat_rack(r: &mut Random) -> Piece {
    let h = r.between(1.6, 1.85);
    let mut piece = Piece::hollow(0.5, 0.5, h);
    solid::cylinder(&mut piece.mesh, Vec3::ZERO, 0.18, 0.03, 14);
    solid::cylinder(&mut piece.mesh, v(0.0, 0.0, 0.03), 0.02, h - 0.03, 8);
    for i in 0..5 {
        let out = Vec2::from_angle(TAU * i as f32 / 5.0).extend(0.0);
        let root = Vec3::Z * (h - 0.15);
        solid::tube(
            &mut piece.mesh,
            root,
            root + out * 0.2 + Vec3::Z * 0.08,
            0.01,
            0.01,
            5,
        );
        if r.chance(0.5) {
            let base = out * 0.14 + Vec3::Z * (h - r.between(0.7, 1.1));
            let length = h - 0.15 - base.z;
            solid::lump(&mut piece.mesh, base, v2(0.1, 0.1), length, 0.3, 8, r);
        }
    }
    piece.block(v(-0.18, -0.18, 0.0), v(0.18, 0.18, 0.5));
    piece.block(v(-0.25, -0.25, 0.5), v(0.25, 0.25, h));
    piece
}

/// A pair of shoes.
pub(super) fn shoes(r: &mut Random) -> Piece {
    let l = r.between(0.24, 0.31);
    let mut piece = Piece::new(0.26, l, 0.11);
    for s in [-1.0f32, 1.0] {
        let x = s * 0.07;
        let sole = v(x, 0.0, 0.02);
        solid::soft_box(&mut piece.mesh, sole, v(0.047, l / 2.0, 0.02), 0.5, 10);
        let heel = v(x, -l * 0.2, 0.06);
        solid::soft_box(&mut piece.mesh, heel, v(0.04, l * 0.28, 0.05), 0.6, 8);
    }
    piece
}

pub(super) fn suitcase(r: &mut Random) -> Piece {
    let (w, d, h) = (
        r.between(0.38, 0.5),
        r.between(0.2, 0.28),
        r.between(0.5, 0.72),
    );
    let mut piece = Piece::new(w, d, h + 0.15);
    let half = v(w / 2.0, d / 2.0, h / 2.0 - 0.03);
    solid::soft_box(&mut piece.mesh, v(0.0, 0.0, h / 2.0 + 0.03), half, 0.25, 16);
    for s in [-1.0f32, 1.0] {
        let x = s * w * 0.25;
        piece.cuboid(
            v(x - 0.008, -d * 0.3, h - 0.02),
            v(x + 0.008, -d * 0.3 + 0.016, h + 0.13),
        );
        piece.cuboid(v(x - 0.02, -0.05, 0.0), v(x + 0.02, 0.05, 0.05));
    }
    piece.cuboid(
        v(-w * 0.27, -d * 0.3, h + 0.13),
        v(w * 0.27, -d * 0.3 + 0.02, h + 0.15),
    );
    piece
}

/// A swivelling fan on a stand, an upright of about a metre.
pub(super) fn fan(r: &mut Random) -> Piece {
    let h = r.between(0.9, 1.2);
    let mut piece = Piece::hollow(0.44, 0.36, h + 0.2);
    solid::cylinder(&mut piece.mesh, Vec3::ZERO, 0.17, 0.03, 16);
    solid::cylinder(&mut piece.mesh, v(0.0, 0.0, 0.03), 0.016, h - 0.05, 8);
    for y in [0.02, 0.1] {
        let cage = Ring {
            center: v(0.0, y, h),
            u: Vec3::X,
            v: Vec3::Z,
            major: 0.2,
            minor: 0.008,
            from: 0.0,
            to: TAU,
        };
        solid::ring(&mut piece.mesh, &cage, 20, 4);
    }
    for i in 0..8 {
        let a = TAU * i as f32 / 8.0;
        let rim = v(0.2 * a.cos(), 0.1, h + 0.2 * a.sin());
        solid::tube(&mut piece.mesh, v(0.0, 0.12, h), rim, 0.005, 0.005, 4);
    }
    let motor = v(0.0, -0.04, h);
    solid::soft_box(&mut piece.mesh, motor, v(0.06, 0.09, 0.06), 0.8, 10);
    piece.block(v(-0.17, -0.17, 0.0), v(0.17, 0.17, h - 0.21));
    piece.block(v(-0.21, -0.14, h - 0.21), v(0.21, 0.14, h + 0.21));
    piece
}
