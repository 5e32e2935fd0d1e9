//! Parametric furniture: seats, tables, beds, storage. Sizes are the ranges measured on ProcTHOR's assets
//! (Deitke et al. 2022: median and 10-90 % of length, depth and height).
use super::draw::{Draw, Random};
use super::layout::{Piece, Use};
use super::solid;
use crate::geometry::Vec3;
use glam::Vec2;

pub(super) fn v(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3::new(x, y, z)
}

/// Four legs, square or round, `inset` from the edges; they fill their places.
pub(super) fn legs(piece: &mut Piece, inset: f32, thick: f32, top: f32, round: bool) {
    let reach = piece.half - inset - thick / 2.0;
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
        let c = reach * Vec2::new(sx, sy);
        let (min, max) = (c - thick / 2.0, c + thick / 2.0);
        piece.block(min.extend(0.0), max.extend(top));
        if round {
            let (foot, head) = (c.extend(0.0), c.extend(top));
            solid::tube(&mut piece.mesh, foot, head, thick * 0.35, thick * 0.5, 8);
        } else {
            piece.cuboid(min.extend(0.0), max.extend(top));
        }
    }
}

/// A table with a top of `width x depth`: four legs with apron, a pedestal, or two trestles.
pub(super) fn table(r: &mut Random, width: f32, depth: f32, height: f32, usage: Use) -> Piece {
    let mut piece = Piece::hollow(width, depth, height);
    let thick = r.between(0.02, 0.045);
    let h = piece.half;
    piece.part((-h).extend(height - thick), h.extend(height));
    match r.weighted(&[4.0, 1.0, 1.0]) {
        0 => {
            let round = r.chance(0.4);
            legs(
                &mut piece,
                0.03,
                r.between(0.04, 0.08),
                height - thick,
                round,
            );
            if r.chance(0.7) {
                let (a, z) = (h - 0.06, height - thick);
                let drop = z - r.between(0.05, 0.09);
                piece.part(v(-a.x, -a.y, drop), v(a.x, -a.y + 0.02, z));
                piece.part(v(-a.x, a.y - 0.02, drop), v(a.x, a.y, z));
                piece.part(v(-a.x, -a.y + 0.02, drop), v(-a.x + 0.02, a.y - 0.02, z));
                piece.part(v(a.x - 0.02, -a.y + 0.02, drop), v(a.x, a.y - 0.02, z));
            }
        }
        1 => {
            let reach = (h.min_element() * 0.6).min(0.35);
            let post = 0.05;
            solid::cylinder(
                &mut piece.mesh,
                v(0.0, 0.0, 0.03),
                post,
                height - thick - 0.03,
                12,
            );
            piece.block(v(-post, -post, 0.03), v(post, post, height - thick));
            solid::cylinder(&mut piece.mesh, Vec3::ZERO, reach, 0.03, 16);
            piece.block(v(-reach, -reach, 0.0), v(reach, reach, 0.03));
        }
        _ => {
            for s in [-1.0f32, 1.0] {
                let x = s * (h.x - 0.15);
                piece.part(v(x - 0.03, -h.y * 0.8, 0.0), v(x + 0.03, h.y * 0.8, 0.05));
                piece.part(v(x - 0.03, -0.05, 0.05), v(x + 0.03, 0.05, height - thick));
            }
        }
    }
    piece.top(0.02, height, usage);
    piece
}

/// A round table on a pedestal.
pub(super) fn round_table(r: &mut Random, radius: f32, height: f32, usage: Use) -> Piece {
    let mut piece = Piece::hollow(2.0 * radius, 2.0 * radius, height);
    let thick = r.between(0.02, 0.04);
    let foot = radius * r.between(0.45, 0.6);
    let profile = [
        (0.0, 0.0),
        (foot, 0.0),
        (foot, 0.02),
        (0.05, 0.06),
        (0.04, height - thick - 0.03),
        (0.1, height - thick),
        (radius, height - thick),
        (radius, height),
        (0.0, height),
    ];
    solid::revolve(&mut piece.mesh, Vec3::ZERO, &profile, 24);
    // Two squares, one turned by 45 degrees, would be closer to a disc; one square is on the safe side.
    piece.block(
        v(-radius, -radius, height - thick),
        v(radius, radius, height),
    );
    piece.block(v(-foot, -foot, 0.0), v(foot, foot, 0.06));
    piece.block(v(-0.1, -0.1, 0.06), v(0.1, 0.1, height - thick));
    let side = Vec2::splat(radius * 0.7);
    piece.surface(-side, side, height, 0.6, usage);
    piece
}

pub(super) fn v2(x: f32, y: f32) -> Vec2 {
    Vec2::new(x, y)
}

/// Sides, boards and mostly a back: an open bookcase or shelf unit whose boards are filled.
pub(super) fn shelf(r: &mut Random, width: f32, depth: f32, height: f32, usage: Use) -> Piece {
    let mut piece = Piece::hollow(width, depth, height);
    let (x, y, t) = (width / 2.0, depth / 2.0, r.between(0.016, 0.028));
    piece.part(v(-x, -y, 0.0), v(-x + t, y, height));
    piece.part(v(x - t, -y, 0.0), v(x, y, height));
    let back = if r.chance(0.75) { 0.008 } else { 0.0 };
    if back > 0.0 {
        piece.part(v(-x + t, -y, 0.0), v(x - t, -y + back, height));
    }
    let foot = r.between(0.03, 0.1);
    let boards = ((height - foot) / r.between(0.28, 0.42)).round().max(1.0) as usize;
    let pitch = (height - foot - t) / boards as f32;
    for i in 0..=boards {
        let z = foot + pitch * i as f32;
        piece.part(v(-x + t, -y + back, z), v(x - t, y, z + t));
        let headroom = if i == boards { 0.5 } else { pitch - t - 0.01 };
        // The top of a tall case is out of reach: mostly empty.
        if i < boards || height < 1.5 || r.chance(0.4) {
            let (min, max) = (v2(-x + t + 0.005, -y + back + 0.005), v2(x - t - 0.005, y));
            piece.surface(min, max, z + t, headroom, usage);
        }
    }
    piece.front = 0.35;
    piece
}

/// A closed cupboard: carcass, `columns x rows` of fronts with gaps and handles. Wardrobe, dresser, cabinet, locker.
pub(super) fn cupboard(
    r: &mut Random,
    [width, depth, height]: [f32; 3],
    columns: usize,
    rows: usize,
) -> Piece {
    let mut piece = Piece::new(width, depth, height);
    let (x, y, lip) = (width / 2.0, depth / 2.0, 0.018);
    let foot = r.between(0.0, 0.1);
    if foot > 0.02 {
        piece.cuboid(v(-x + 0.03, -y, 0.0), v(x - 0.03, y - 0.05, foot));
    }
    piece.cuboid(v(-x, -y, foot), v(x, y - lip, height));
    let (fw, fh) = (width / columns as f32, (height - foot - 0.02) / rows as f32);
    let knob = r.chance(0.5);
    for i in 0..columns {
        for j in 0..rows {
            let (a, z) = (-x + fw * i as f32 + 0.003, foot + fh * j as f32 + 0.003);
            let front = y - 0.012;
            piece.cuboid(v(a, y - lip, z), v(a + fw - 0.006, front, z + fh - 0.006));
            let tall = fh > fw;
            let (hx, hz) = if tall {
                let towards = if i % 2 == 0 { 0.9 } else { 0.1 };
                (a + fw * towards, z + fh * 0.5)
            } else {
                (a + fw * 0.5, z + fh * 0.7)
            };
            let half = match (knob, tall) {
                (true, _) => v2(0.012, 0.012),
                (false, true) => v2(0.006, 0.07),
                (false, false) => v2(0.07, 0.006),
            };
            piece.cuboid(
                v(hx - half.x, front, hz - half.y),
                v(hx + half.x, y, hz + half.y),
            );
        }
    }
    if height < 1.4 {
        piece.top(0.02, height, Use::Cupboard);
    }
    piece.front = 0.35;
    piece
}

pub(super) fn wardrobe(r: &mut Random) -> Piece {
    let columns = r.count(1, 3);
    let width = columns as f32 * r.between(0.45, 0.6);
    let size = [width, r.between(0.52, 0.62), r.between(1.8, 2.2)];
    cupboard(r, size, columns, 1)
}

pub(super) fn dresser(r: &mut Random) -> Piece {
    let size = [
        r.between(0.7, 1.5),
        r.between(0.42, 0.55),
        r.between(0.7, 1.1),
    ];
    let (columns, rows) = (r.count(1, 3), r.count(3, 5));
    cupboard(r, size, columns, rows)
}

pub(super) fn nightstand(r: &mut Random) -> Piece {
    let size = [
        r.between(0.38, 0.52),
        r.between(0.34, 0.45),
        r.between(0.42, 0.6),
    ];
    let rows = r.count(1, 3);
    let mut piece = cupboard(r, size, 1, rows);
    piece.surfaces.clear();
    piece.top(0.01, size[2], Use::Bedside);
    piece.front = 0.0;
    piece
}

/// A desk: top, side panels or legs, mostly a block of drawers; leg room at the front (+y).
pub(super) fn desk(r: &mut Random) -> Piece {
    let (w, d, h) = (
        r.between(1.1, 1.7),
        r.between(0.58, 0.8),
        r.between(0.71, 0.77),
    );
    let mut piece = Piece::hollow(w, d, h);
    let (x, y, t) = (w / 2.0, d / 2.0, 0.028);
    piece.part(v(-x, -y, h - t), v(x, y, h));
    if r.chance(0.5) {
        legs(&mut piece, 0.01, 0.05, h - t, false);
    } else {
        piece.part(v(-x, -y, 0.0), v(-x + t, y, h - t));
        piece.part(v(x - t, -y, 0.0), v(x, y, h - t));
    }
    if r.chance(0.4) {
        piece.part(v(-x + 0.07, -y + 0.02, 0.3), v(x - 0.07, -y + 0.04, h - t));
    }
    if r.chance(0.65) {
        let s = r.one_of(&[-1.0f32, 1.0]);
        let (cx, half) = (s * (x - 0.29), 0.2);
        piece.part(
            v(cx - half, -y + 0.07, 0.03),
            v(cx + half, y - 0.07, h - t - 0.03),
        );
        for i in 0..3 {
            let z = 0.05 + (h - 0.1) * i as f32 / 3.0;
            let top = z + (h - 0.1) / 3.0 - 0.04;
            piece.cuboid(v(cx - half, y - 0.07, z), v(cx + half, y - 0.055, top));
        }
    }
    piece.top(0.02, h, Use::Desk);
    piece
}

/// A coffee table, sometimes with a lower board.
pub(super) fn coffee_table(r: &mut Random) -> Piece {
    let (w, d, h) = (
        r.between(0.8, 1.3),
        r.between(0.5, 0.75),
        r.between(0.35, 0.48),
    );
    if r.chance(0.25) {
        return round_table(r, d * 0.65, h, Use::Coffee);
    }
    let mut piece = Piece::hollow(w, d, h);
    let t = r.between(0.02, 0.05);
    let half = piece.half;
    piece.part((-half).extend(h - t), half.extend(h));
    let round = r.chance(0.4);
    legs(&mut piece, 0.02, r.between(0.035, 0.06), h - t, round);
    if r.chance(0.5) {
        let board = half - 0.09;
        piece.part((-board).extend(0.1), board.extend(0.12));
        piece.surface(-board, board, 0.12, h - t - 0.14, Use::Coffee);
    }
    piece.top(0.02, h, Use::Coffee);
    piece
}

/// A low board with a television on it.
pub(super) fn tv_stand(r: &mut Random) -> Piece {
    let size = [
        r.between(1.0, 1.8),
        r.between(0.38, 0.5),
        r.between(0.4, 0.6),
    ];
    let columns = r.count(2, 4);
    let mut piece = cupboard(r, size, columns, 1);
    piece.surfaces.clear();
    piece.front = 0.3;
    let w = r.between(0.8, 1.35).min(size[0] * 0.95);
    let tall = w * 0.57;
    let h = size[2];
    piece.height = h + 0.06 + tall;
    piece.part(
        v(-w / 2.0, -0.06, h + 0.06),
        v(w / 2.0, -0.02, h + 0.06 + tall),
    );
    for s in [-0.35f32, 0.35] {
        piece.part(v(s * w - 0.02, -0.14, h), v(s * w + 0.02, 0.08, h + 0.015));
        piece.part(
            v(s * w - 0.015, -0.05, h + 0.015),
            v(s * w + 0.015, -0.03, h + 0.06),
        );
    }
    let (x, y) = (size[0] / 2.0, size[1] / 2.0);
    piece.surface(v2(-x, 0.09), v2(x, y - 0.01), h, 0.3, Use::Coffee);
    piece
}
