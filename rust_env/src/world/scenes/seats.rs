//! Parametric seats and beds. Sizes are the ranges measured on ProcTHOR's assets (Deitke et al. 2022).
use super::draw::{Draw, Random};
use super::furniture::{legs, v, v2};
use super::layout::{Piece, Use};
use super::solid;
use crate::geometry::Vec3;
use std::f32::consts::TAU;

/// A four-legged chair; the back is slatted or solid, the front is +y.
pub(super) fn chair(r: &mut Random) -> Piece {
    let (w, d) = (r.between(0.4, 0.5), r.between(0.4, 0.5));
    let (seat, h) = (r.between(0.43, 0.47), r.between(0.8, 1.0));
    let mut piece = Piece::hollow(w, d, h);
    let (x, y) = (w / 2.0, d / 2.0);
    piece.cuboid(v(-x, -y, seat - 0.035), v(x, y, seat));
    let thick = r.between(0.025, 0.04);
    let round = r.chance(0.4);
    legs(&mut piece, 0.005, thick, seat - 0.035, round);
    piece.blocks.clear();
    // Under the seat a chair counts as full: nothing is put between its legs.
    piece.block(v(-x, -y, 0.0), v(x, y, seat));
    piece.block(v(-x, -y, seat), v(x, -y + 0.06, h));
    for s in [-1.0f32, 1.0] {
        let side = s * (x - thick / 2.0);
        piece.cuboid(
            v(side - thick / 2.0, -y, seat),
            v(side + thick / 2.0, -y + thick, h),
        );
    }
    match r.count(0, 2) {
        0 => piece.cuboid(
            v(-x + thick, -y + 0.005, seat + 0.12),
            v(x - thick, -y + 0.025, h),
        ),
        1 => {
            for z in [0.35, 0.65, 0.95] {
                let z = seat + (h - seat) * z;
                piece.cuboid(
                    v(-x + thick, -y + 0.005, z - 0.03),
                    v(x - thick, -y + 0.025, z),
                );
            }
        }
        _ => {
            piece.cuboid(v(-x + thick, -y, h - 0.06), v(x - thick, -y + 0.03, h));
            for i in 1..5 {
                let c = -x + w * i as f32 / 5.0;
                piece.cuboid(
                    v(c - 0.01, -y + 0.01, seat),
                    v(c + 0.01, -y + 0.02, h - 0.06),
                );
            }
        }
    }
    piece.tucks = true;
    if r.chance(0.08) {
        piece.surface(v2(-x, -y + 0.08), v2(x, y), seat, 0.5, Use::Seat);
    }
    piece
}

pub(super) fn stool(r: &mut Random, seat: f32) -> Piece {
    let size = r.between(0.3, 0.38);
    let mut piece = Piece::new(size, size, seat);
    piece.tucks = true;
    let center = v(0.0, 0.0, seat - 0.04);
    solid::cylinder(&mut piece.mesh, center, size / 2.0, 0.04, 16);
    for i in 0..4 {
        let a = TAU * (i as f32 + 0.5) / 4.0;
        let out = v(a.cos(), a.sin(), 0.0);
        let head = out * (size * 0.3) + Vec3::Z * (seat - 0.04);
        solid::tube(
            &mut piece.mesh,
            out * (size * 0.46) + Vec3::Z * 0.004,
            head,
            0.012,
            0.015,
            6,
        );
    }
    piece
}

/// An office chair: five-armed base on castors, gas spring, padded seat and back, mostly with arm rests.
pub(super) fn office_chair(r: &mut Random) -> Piece {
    let (w, d) = (r.between(0.46, 0.52), r.between(0.46, 0.52));
    let (seat, h) = (r.between(0.44, 0.52), r.between(0.9, 1.15));
    let mut piece = Piece::hollow(w + 0.08, d + 0.08, h);
    piece.tucks = true;
    let (x, y) = (w / 2.0, d / 2.0);
    for i in 0..5 {
        let a = TAU * i as f32 / 5.0;
        let tip = v(a.cos() * 0.24, a.sin() * 0.24, 0.06);
        solid::tube(&mut piece.mesh, v(0.0, 0.0, 0.1), tip, 0.025, 0.015, 6);
        solid::ball(&mut piece.mesh, tip - Vec3::Z * 0.03, 0.028, 6);
    }
    solid::cylinder(&mut piece.mesh, v(0.0, 0.0, 0.06), 0.028, seat - 0.12, 8);
    let half = v(x, y, 0.04);
    solid::soft_box(&mut piece.mesh, v(0.0, 0.0, seat - 0.04), half, 0.4, 12);
    let (low, top) = (seat + 0.1, h);
    let back = v(0.0, -y + 0.03, (low + top) / 2.0);
    let half = v(x * 0.92, 0.035, (top - low) / 2.0);
    solid::soft_box(&mut piece.mesh, back, half, 0.4, 12);
    piece.cuboid(
        v(-0.03, -y - 0.01, seat - 0.06),
        v(0.03, -y + 0.01, low + 0.2),
    );
    let e = piece.half;
    piece.block((-e).extend(0.0), e.extend(seat));
    piece.block(v(-e.x, -e.y, seat), v(e.x, -y + 0.1, h));
    if r.chance(0.6) {
        for s in [-1.0f32, 1.0] {
            let a = s * (x + 0.02);
            piece.cuboid(
                v(a - 0.015, -0.03, seat - 0.06),
                v(a + 0.015, 0.03, seat + 0.17),
            );
            piece.part(
                v(a - 0.02, -0.14, seat + 0.17),
                v(a + 0.02, 0.12, seat + 0.2),
            );
        }
    }
    piece
}

/// A sofa for `seats` people (1 = armchair) with seat, back and loose cushions.
pub(super) fn sofa(r: &mut Random, seats: usize) -> Piece {
    let arm = r.between(0.1, 0.22);
    let w = seats as f32 * r.between(0.58, 0.72) + 2.0 * arm;
    let (d, h) = (r.between(0.82, 1.0), r.between(0.74, 0.95));
    let seat = r.between(0.38, 0.45);
    let mut piece = Piece::hollow(w, d, h);
    let (x, y, back, foot) = (
        w / 2.0,
        d / 2.0,
        r.between(0.16, 0.24),
        r.between(0.03, 0.12),
    );
    let base = seat - 0.14;
    piece.cuboid(v(-x, -y, foot), v(x, y, base));
    let arm_top = r.between(0.5, 0.65);
    for s in [-1.0f32, 1.0] {
        let (a, b) = if s < 0.0 {
            (-x, -x + arm)
        } else {
            (x - arm, x)
        };
        piece.cuboid(v(a, -y + back, base), v(b, y, arm_top - 0.04));
        let center = v((a + b) / 2.0, back / 2.0, arm_top - 0.04);
        let half = v(arm / 2.0, (d - back) / 2.0, 0.04);
        solid::soft_box(&mut piece.mesh, center, half, 0.4, 12);
        for c in [-y + 0.05, y - 0.05] {
            let leg = v(s * (x - 0.06), c, 0.0);
            solid::cylinder(&mut piece.mesh, leg, 0.025, foot, 6);
        }
    }
    piece.cuboid(v(-x, -y, base), v(x, -y + back * 0.6, h));
    let each = (w - 2.0 * arm) / seats as f32;
    for i in 0..seats {
        let c = -x + arm + each * (i as f32 + 0.5);
        let half = v(each / 2.0 - 0.005, (d - back) / 2.0, 0.075);
        solid::soft_box(
            &mut piece.mesh,
            v(c, back / 2.0, seat - 0.07),
            half,
            0.3,
            16,
        );
        let half = v(each / 2.0 - 0.01, back * 0.45, (h - seat) / 2.0);
        let center = v(c, -y + back * 0.75, seat + half.z);
        solid::soft_box(&mut piece.mesh, center, half, 0.35, 16);
    }
    piece.block(v(-x, -y, 0.0), v(x, y, seat + 0.01));
    piece.block(v(-x, -y, seat + 0.01), v(x, -y + back * 1.25, h));
    piece.block(v(-x, -y + back, seat + 0.01), v(-x + arm, y, arm_top));
    piece.block(v(x - arm, -y + back, seat + 0.01), v(x, y, arm_top));
    let (min, max) = (v2(-x + arm, -y + back * 1.25), v2(x - arm, y));
    piece.surface(min, max, seat + 0.01, 0.6, Use::Seat);
    piece.front = 0.25;
    piece
}

/// A bed for one or two, head at the back; sometimes a bunk bed.
pub(super) fn bed(r: &mut Random, width: f32) -> Piece {
    let (l, h) = (r.between(1.95, 2.15), r.between(0.75, 1.15));
    let top = r.between(0.45, 0.6);
    let mut piece = Piece::hollow(width, l, h);
    let (x, y) = (width / 2.0, l / 2.0);
    let frame = top - 0.2;
    piece.cuboid(v(-x, -y, 0.0), v(x, -y + 0.06, h));
    piece.cuboid(v(-x, -y + 0.06, frame - 0.12), v(x, y, frame));
    if r.chance(0.5) {
        piece.cuboid(v(-x, y - 0.05, frame), v(x, y, top + 0.02));
    }
    for s in [-1.0f32, 1.0] {
        let leg = v(s * (x - 0.05), y - 0.06, 0.0);
        piece.cuboid(leg - v(0.03, 0.03, 0.0), leg + v(0.03, 0.03, frame - 0.12));
    }
    let mattress = v(0.0, 0.0, frame + 0.09);
    let half = v(x - 0.02, y - 0.07, 0.09);
    solid::soft_box(&mut piece.mesh, mattress, half, 0.15, 16);
    // The blanket hangs over the sides, made or thrown back.
    let from = -y + l * r.between(0.25, 0.5);
    if r.chance(0.6) {
        piece.cuboid(v(-x + 0.01, from, top - 0.04), v(x - 0.01, y - 0.06, top));
    } else {
        let base = v(r.between(-0.15, 0.15) * x, (from + y) / 2.0, frame + 0.16);
        let half = v2(x * 0.75, (y - from) / 2.0 * 0.9);
        solid::lump(&mut piece.mesh, base, half, 0.16, 0.4, 20, r);
    }
    let pillows = if width > 1.2 { 2 } else { 1 };
    for i in 0..pillows {
        let c = (i as f32 - 0.5 * (pillows - 1) as f32) * width / 2.0;
        let half = v(0.3f32.min(x * 0.8), 0.2, 0.075);
        let center = v(c + r.between(-0.03, 0.03), -y + 0.3, frame + 0.24);
        solid::soft_box(&mut piece.mesh, center, half, 0.5, 14);
    }
    piece.block(v(-x, -y, 0.0), v(x, y, top + 0.05));
    piece.block(v(-x, -y, top + 0.05), v(x, -y + 0.6, h));
    piece
}
