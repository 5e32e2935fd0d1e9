//! Parametric bathroom fittings.
use super::draw::{Draw, Random};
use super::fixtures::v;
use super::layout::{Piece, Use};
use super::solid::{self, Ring};
use crate::geometry::Vec3;
use std::f32::consts::TAU;

pub(super) fn washing_machine(r: &mut Random) -> Piece {
    let mut piece = Piece::new(0.6, r.between(0.5, 0.6), 0.85);
    let (x, y) = (piece.half.x, piece.half.y);
    piece.cuboid(v(-x, -y, 0.0), v(x, y - 0.03, 0.85));
    let center = v(0.0, y - 0.028, 0.45);
    let door = Ring {
        center,
        u: Vec3::X,
        v: Vec3::Z,
        major: 0.17,
        minor: 0.025,
        from: 0.0,
        to: TAU,
    };
    solid::ring(&mut piece.mesh, &door, 16, 6);
    piece.top(0.05, 0.85, Use::Bathroom);
    piece.front = 0.4;
    piece
}

pub(super) fn toilet(r: &mut Random) -> Piece {
    let (w, d) = (r.between(0.36, 0.42), r.between(0.62, 0.72));
    let mut piece = Piece::hollow(w, d, 0.8);
    let (x, y) = (w / 2.0, d / 2.0);
    piece.cuboid(v(-x, -y, 0.4), v(x, -y + 0.18, 0.8));
    piece.cuboid(v(-0.1, -y, 0.0), v(0.1, -y + 0.3, 0.4));
    let bowl = v(0.0, 0.09, 0.0);
    let start = piece.mesh.vertices.len();
    let profile = [
        (0.0, 0.0),
        (0.13, 0.0),
        (0.12, 0.15),
        (0.19, 0.38),
        (0.19, 0.42),
        (0.14, 0.42),
        (0.1, 0.25),
        (0.0, 0.2),
    ];
    solid::revolve(&mut piece.mesh, Vec3::ZERO, &profile, 16);
    for p in &mut piece.mesh.vertices[start..] {
        *p = *p * v(x / 0.2, (y - 0.1) / 0.2, 1.0) + bowl;
    }
    piece.block(v(-x, -y, 0.0), v(x, y, 0.43));
    piece.block(v(-x, -y, 0.43), v(x, -y + 0.18, 0.8));
    piece.front = 0.35;
    piece
}

/// A wash basin on a pedestal or on a cupboard.
pub(super) fn washbasin(r: &mut Random) -> Piece {
    let (w, d, h) = (r.between(0.5, 0.8), r.between(0.42, 0.5), 0.86);
    let mut piece = Piece::new(w, d, h);
    let (x, y) = (w / 2.0, d / 2.0);
    if r.chance(0.5) {
        piece.cuboid(v(-x + 0.02, -y, 0.05), v(x - 0.02, y - 0.03, h - 0.16));
    } else {
        solid::cylinder(&mut piece.mesh, v(0.0, -0.05, 0.0), 0.1, h - 0.16, 12);
    }
    piece.cuboid(v(-x, -y, h - 0.16), v(x, y, h - 0.14));
    piece.cuboid(v(-x, -y, h - 0.14), v(x, -y + 0.12, h));
    piece.cuboid(v(-x, y - 0.03, h - 0.14), v(x, y, h));
    piece.cuboid(v(-x, -y + 0.12, h - 0.14), v(-x + 0.03, y - 0.03, h));
    piece.cuboid(v(x - 0.03, -y + 0.12, h - 0.14), v(x, y - 0.03, h));
    let tap = v(0.0, -y + 0.07, h);
    solid::tube(&mut piece.mesh, tap, tap + Vec3::Z * 0.12, 0.013, 0.013, 6);
    piece.block(v(-0.03, -y + 0.03, h), v(0.03, -y + 0.19, h + 0.13));
    let spout = tap + Vec3::Z * 0.11;
    solid::tube(&mut piece.mesh, spout, spout + Vec3::Y * 0.1, 0.01, 0.01, 6);
    piece.front = 0.4;
    piece
}

pub(super) fn bathtub(r: &mut Random) -> Piece {
    let (w, d, h) = (
        r.between(1.55, 1.8),
        r.between(0.7, 0.8),
        r.between(0.5, 0.6),
    );
    let mut piece = Piece::new(w, d, h);
    let (x, y, t) = (w / 2.0, d / 2.0, 0.07);
    piece.cuboid(v(-x, -y, 0.0), v(x, y, 0.12));
    piece.cuboid(v(-x, -y, 0.12), v(x, -y + t, h));
    piece.cuboid(v(-x, y - t, 0.12), v(x, y, h));
    piece.cuboid(v(-x, -y + t, 0.12), v(-x + t, y - t, h));
    piece.cuboid(v(x - t, -y + t, 0.12), v(x, y - t, h));
    piece
}
