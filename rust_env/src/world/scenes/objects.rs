//! Parametric small things: crockery, bottles, books, boxes, lamps. `n` = points per turn of round things.
use super::draw::{Draw, Random};
use super::layout::Piece;
use super::solid::{self, Ring};
use crate::geometry::Vec3;
use glam::Vec2;
use std::f32::consts::{PI, TAU};

pub(super) fn v(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3::new(x, y, z)
}

/// A piece that fills a square around its axis and has one surface of revolution.
pub(super) fn turned(profile: &[(f32, f32)], n: u32) -> Piece {
    let radius = profile.iter().fold(0.0f32, |m, p| m.max(p.0));
    let height = profile.iter().fold(0.0f32, |m, p| m.max(p.1));
    let mut piece = Piece::new(2.0 * radius, 2.0 * radius, height);
    solid::revolve(&mut piece.mesh, Vec3::ZERO, profile, n);
    piece
}

pub(super) fn box_of(width: f32, depth: f32, height: f32) -> Piece {
    let mut piece = Piece::new(width, depth, height);
    piece.cuboid((-piece.half).extend(0.0), piece.half.extend(height));
    piece
}

/// A closed box with sides between `least` and `most`.
pub(super) fn carton(r: &mut Random, least: f32, most: f32) -> Piece {
    let [a, b, c] = [0; 3].map(|_| r.between(least, most));
    box_of(a, b, c)
}

/// An open cardboard box with four flaps.
pub(super) fn open_box(r: &mut Random) -> Piece {
    let (w, d, h) = (
        r.between(0.3, 0.6),
        r.between(0.25, 0.45),
        r.between(0.2, 0.4),
    );
    let mut piece = Piece::new(w + 0.16, d + 0.16, h + 0.06);
    let t = 0.008;
    let (x, y) = (w / 2.0, d / 2.0);
    piece.cuboid(v(-x, -y, 0.0), v(x, y, t));
    piece.cuboid(v(-x, -y, t), v(-x + t, y, h));
    piece.cuboid(v(x - t, -y, t), v(x, y, h));
    piece.cuboid(v(-x + t, -y, t), v(x - t, -y + t, h));
    piece.cuboid(v(-x + t, y - t, t), v(x - t, y, h));
    let flap = 0.08;
    for s in [-1.0f32, 1.0] {
        // Flaps lean outwards: thin slabs drawn as bars from the rim.
        let base = piece.mesh.vertices.len() as u32;
        let up = r.between(0.01, 0.06);
        piece.mesh.vertices.extend([
            v(s * x, -y, h),
            v(s * x, y, h),
            v(s * (x + flap), y, h + up),
            v(s * (x + flap), -y, h + up),
            v(-x, s * y, h),
            v(x, s * y, h),
            v(x, s * (y + flap), h + up),
            v(-x, s * (y + flap), h + up),
        ]);
        for q in [0, 4] {
            let a = base + q;
            piece.mesh.triangles.push([a, a + 1, a + 2]);
            piece.mesh.triangles.push([a, a + 2, a + 3]);
        }
    }
    piece
}

pub(super) fn toaster(r: &mut Random) -> Piece {
    let (w, d, h) = (
        r.between(0.26, 0.32),
        r.between(0.15, 0.19),
        r.between(0.17, 0.21),
    );
    let mut piece = Piece::new(w, d, h);
    let (x, y) = (w / 2.0, d / 2.0);
    piece.cuboid(v(-x, -y, 0.0), v(x, y, h - 0.02));
    for s in [-0.6f32, 0.0, 0.6] {
        piece.cuboid(
            v(-x + 0.02, s * y - 0.012, h - 0.02),
            v(x - 0.02, s * y + 0.012, h),
        );
    }
    piece
}

pub(super) fn sphere(r: &mut Random, n: u32) -> Piece {
    let radius = r.between(0.04, 0.12);
    let mut piece = Piece::new(2.0 * radius, 2.0 * radius, 2.0 * radius);
    solid::ball(&mut piece.mesh, v(0.0, 0.0, radius), radius, n);
    piece
}

/// Books lying on each other, each a little turned.
pub(super) fn book_stack(r: &mut Random) -> Piece {
    let (w, d) = (r.between(0.13, 0.2), r.between(0.19, 0.28));
    let mut piece = Piece::hollow(w * 1.15, d * 1.1, 0.0);
    let mut z = 0.0;
    for _ in 0..r.count(1, 6) {
        let thick = r.between(0.012, 0.045);
        let shrink = r.between(0.75, 1.0);
        let half = v(w * shrink / 2.0, d * shrink / 2.0, thick / 2.0);
        let yaw = r.between(-0.15, 0.15);
        book(&mut piece, v(0.0, 0.0, z + thick / 2.0), half, yaw);
        z += thick;
    }
    piece.height = z;
    piece.block((-piece.half).extend(0.0), piece.half.extend(z));
    piece
}

/// Two covers, a spine and the recessed pages: what a laser sees of a book.
fn book(piece: &mut Piece, center: Vec3, half: Vec3, yaw: f32) {
    let cover = 0.002;
    let offset = Vec2::from_angle(yaw)
        .rotate(Vec2::new(0.003, 0.0))
        .extend(0.0);
    let pages = v(half.x - 0.005, half.y - 0.004, half.z - cover);
    for s in [-1.0f32, 1.0] {
        let at = center + Vec3::Z * (s * (half.z - cover / 2.0));
        solid::turned_cuboid(&mut piece.mesh, at, v(half.x, half.y, cover / 2.0), yaw);
    }
    solid::turned_cuboid(&mut piece.mesh, center - offset, pages, yaw);
}

/// Books standing side by side; fits into a shelf of the given width, depth and free height.
pub(super) fn book_row(r: &mut Random, room: Vec2, headroom: f32) -> Piece {
    let width = r.between(0.12, 0.6).min(room.x * 0.95);
    let (tall, deep) = (
        r.between(0.17, 0.31).min(headroom - 0.01),
        r.between(0.13, 0.21).min(room.y * 0.95),
    );
    let mut piece = Piece::hollow(width, deep, tall);
    let (mut x, y) = (-width / 2.0, deep / 2.0);
    while x < width / 2.0 - 0.015 {
        let end = (x + r.between(0.015, 0.055)).min(width / 2.0);
        let h = tall * r.between(0.75, 1.0);
        piece.cuboid(
            v(x, -y + deep * r.between(0.0, 0.2), 0.0),
            v(end - 0.001, y, h),
        );
        x = end;
    }
    piece.block((-piece.half).extend(0.0), piece.half.extend(tall));
    piece
}

pub(super) fn picture_frame(r: &mut Random) -> Piece {
    let (w, h) = (r.between(0.12, 0.25), r.between(0.15, 0.28));
    let mut piece = Piece::new(w, 0.08, h);
    piece.cuboid(v(-w / 2.0, -0.008, 0.0), v(w / 2.0, 0.008, h));
    piece.cuboid(v(-0.02, -0.04, 0.0), v(0.02, -0.008, h * 0.6));
    piece
}

pub(super) fn pen_pot(r: &mut Random, n: u32) -> Piece {
    let (radius, h) = (r.between(0.03, 0.045), r.between(0.08, 0.11));
    let mut piece = Piece::new(2.2 * radius, 2.2 * radius, h + 0.07);
    let n = n.min(16);
    solid::vessel(&mut piece.mesh, Vec3::ZERO, [radius, radius], h, 0.003, n);
    for _ in 0..r.count(2, 6) {
        let a = r.heading();
        let foot = v(-a.cos(), -a.sin(), 0.0) * (radius * 0.6) + v(0.0, 0.0, 0.01);
        let tip = v(a.cos(), a.sin(), 0.0) * (radius * 0.85);
        let tip = tip + v(0.0, 0.0, h + r.between(0.02, 0.07));
        solid::tube(&mut piece.mesh, foot, tip, 0.004, 0.004, 5);
    }
    piece
}

pub(super) fn table_lamp(r: &mut Random, n: u32) -> Piece {
    let (h, shade) = (r.between(0.32, 0.55), r.between(0.09, 0.16));
    let mut piece = Piece::new(2.0 * shade, 2.0 * shade, h);
    let foot = shade * 0.6;
    let stem = [
        (0.0, 0.0),
        (foot, 0.0),
        (foot, 0.015),
        (0.012, 0.03),
        (r.between(0.012, 0.05), 0.3 * h),
        (0.01, 0.6 * h),
        (0.01, 0.8 * h),
        (0.0, 0.8 * h),
    ];
    solid::revolve(&mut piece.mesh, Vec3::ZERO, &stem, n);
    lamp_shade(
        &mut piece,
        0.6 * h,
        h,
        shade,
        shade * r.between(0.5, 0.9),
        n,
    );
    piece
}

/// An open shade from `z0` (radius `low`) to `z1` (radius `high`).
pub(super) fn lamp_shade(piece: &mut Piece, z0: f32, z1: f32, low: f32, high: f32, n: u32) {
    let profile = [
        (low - 0.004, z0),
        (low, z0),
        (high, z1),
        (high - 0.004, z1),
        (low - 0.004, z0 + 0.001),
    ];
    solid::revolve(&mut piece.mesh, Vec3::ZERO, &profile, n);
}

pub(super) fn small_plant(r: &mut Random, n: u32) -> Piece {
    let (pot, h) = (r.between(0.04, 0.08), r.between(0.15, 0.35));
    let reach = pot * r.between(1.4, 2.2);
    let mut piece = Piece::new(2.0 * reach, 2.0 * reach, h);
    let tall = pot * 1.6;
    solid::vessel(
        &mut piece.mesh,
        Vec3::ZERO,
        [pot * 0.75, pot],
        tall,
        0.006,
        n,
    );
    solid::cylinder(
        &mut piece.mesh,
        v(0.0, 0.0, tall * 0.8),
        pot * 0.9,
        0.004,
        n,
    );
    leaves(&mut piece, tall, reach, h - tall, r.count(6, 14), r);
    piece
}

/// Leaves around the axis from height `z`, not beyond `reach` nor higher than `rise`.
pub(super) fn leaves(
    piece: &mut Piece,
    z: f32,
    reach: f32,
    rise: f32,
    count: usize,
    r: &mut Random,
) {
    for i in 0..count {
        let yaw = TAU * (i as f32 * 0.382) + r.between(-0.3, 0.3);
        // The spine of a leaf of length l rises to about 0.4 l before it droops.
        let length = (reach * r.between(0.6, 0.95)).min(rise.max(0.05) / 0.45);
        let root = v(
            0.0,
            0.0,
            z + r.between(0.0, 0.5) * (rise - 0.45 * length).max(0.0),
        );
        let width = length * r.between(0.15, 0.3);
        solid::leaf(
            &mut piece.mesh,
            root,
            yaw,
            length,
            width,
            r.between(0.4, 1.0),
        );
    }
}

pub(super) fn monitor(r: &mut Random) -> Piece {
    let (w, h) = (r.between(0.45, 0.65), r.between(0.28, 0.38));
    let lift = r.between(0.08, 0.14);
    let mut piece = Piece::new(w, 0.2, h + lift);
    piece.cuboid(v(-w / 2.0, -0.02, lift), v(w / 2.0, 0.02, lift + h));
    piece.cuboid(v(-0.03, -0.05, 0.01), v(0.03, -0.02, lift + h * 0.5));
    piece.cuboid(v(-0.11, -0.1, 0.0), v(0.11, 0.08, 0.01));
    piece
}

pub(super) fn keyboard(r: &mut Random) -> Piece {
    let (w, d) = (r.between(0.3, 0.45), r.between(0.12, 0.16));
    let mut piece = box_of(w, d, 0.012);
    for row in 0..4 {
        let y = -d / 2.0 + d * (row as f32 + 0.6) / 4.2;
        piece.cuboid(
            v(-w * 0.47, y - d * 0.1, 0.012),
            v(w * 0.47, y + d * 0.08, 0.02),
        );
    }
    piece.height = 0.02;
    piece
}

pub(super) fn laptop(r: &mut Random) -> Piece {
    let (w, d) = (r.between(0.3, 0.37), r.between(0.21, 0.26));
    let mut piece = Piece::new(w, d + 0.1, d + 0.02);
    let y = d / 2.0;
    piece.cuboid(v(-w / 2.0, -y + 0.05, 0.0), v(w / 2.0, y + 0.05, 0.018));
    // The screen leans back: a sheet with a little thickness.
    let back = v(0.0, -0.07, d * 0.95);
    let first = piece.mesh.vertices.len() as u32;
    for side in [-w / 2.0, w / 2.0] {
        let hinge = v(side, -y + 0.05, 0.018);
        piece.mesh.vertices.extend([
            hinge,
            hinge + back,
            hinge + v(0.0, 0.008, 0.0),
            hinge + back + v(0.0, 0.008, 0.0),
        ]);
    }
    for q in [[0, 1, 5, 4], [2, 6, 7, 3], [1, 3, 7, 5]] {
        let q = q.map(|i| first + i);
        piece.mesh.triangles.push([q[0], q[1], q[2]]);
        piece.mesh.triangles.push([q[0], q[2], q[3]]);
    }
    piece
}

pub(super) fn speaker(r: &mut Random, n: u32) -> Piece {
    let (w, h) = (r.between(0.12, 0.2), r.between(0.2, 0.32));
    let mut piece = box_of(w, w, h);
    for (z, size) in [(0.3, 0.36), (0.75, 0.2)] {
        let center = v(0.0, w / 2.0 - 0.001, z * h);
        let radius = (w * size).min(0.22 * h);
        solid::tube(
            &mut piece.mesh,
            center,
            center + Vec3::Y * 0.008,
            radius,
            0.9 * radius,
            n,
        );
    }
    piece
}

pub(super) fn basket(r: &mut Random, n: u32) -> Piece {
    let (radius, h) = (r.between(0.09, 0.16), r.between(0.1, 0.2));
    let mut piece = Piece::new(2.0 * radius, 2.0 * radius, h);
    let radii = [radius * 0.8, radius];
    solid::vessel(&mut piece.mesh, Vec3::ZERO, radii, h, 0.01, n);
    piece
}

pub(super) fn towels(r: &mut Random, n: u32) -> Piece {
    let count = r.count(2, 4);
    let (w, d, t) = (r.between(0.25, 0.35), r.between(0.2, 0.25), 0.045);
    let mut piece = Piece::new(w, d, t * count as f32);
    for i in 0..count {
        let center = v(0.0, 0.0, t * (i as f32 + 0.5));
        let half = v(w / 2.0 * r.between(0.9, 1.0), d / 2.0, t / 2.0);
        solid::soft_box(&mut piece.mesh, center, half, 0.35, n);
    }
    piece
}

pub(super) fn cushion(r: &mut Random, n: u32) -> Piece {
    let size = r.between(0.35, 0.5);
    let h = r.between(0.12, 0.18);
    let mut piece = Piece::new(size, size, h);
    let half = v(size / 2.0, size / 2.0, h / 2.0);
    solid::soft_box(&mut piece.mesh, v(0.0, 0.0, h / 2.0), half, 0.5, n);
    piece
}

pub(super) fn clothes(r: &mut Random, n: u32) -> Piece {
    let (w, d, h) = (
        r.between(0.25, 0.5),
        r.between(0.25, 0.45),
        r.between(0.06, 0.2),
    );
    let mut piece = Piece::new(w, d, h);
    solid::lump(&mut piece.mesh, Vec3::ZERO, piece.half, h, 0.35, n, r);
    piece
}

pub(super) fn bag(r: &mut Random, n: u32) -> Piece {
    let (w, d, h) = (
        r.between(0.28, 0.42),
        r.between(0.18, 0.28),
        r.between(0.3, 0.5),
    );
    let mut piece = Piece::new(w, d, h);
    solid::lump(&mut piece.mesh, Vec3::ZERO, piece.half, h * 0.9, 0.12, n, r);
    let handle = Ring {
        center: v(0.0, 0.0, h * 0.85),
        u: Vec3::X,
        v: Vec3::Z,
        major: h * 0.13,
        minor: 0.009,
        from: 0.0,
        to: PI,
    };
    solid::ring(&mut piece.mesh, &handle, 6, 5);
    piece
}

/// A tall basket heaped with clothes.
pub(super) fn laundry(r: &mut Random) -> Piece {
    let (radius, h) = (r.between(0.18, 0.26), r.between(0.45, 0.65));
    let mut piece = Piece::new(2.0 * radius, 2.0 * radius, h + 0.12);
    let radii = [radius * 0.85, radius];
    solid::vessel(&mut piece.mesh, Vec3::ZERO, radii, h, 0.01, 16);
    let heap = Vec2::splat(radius * 0.9);
    solid::lump(
        &mut piece.mesh,
        v(0.0, 0.0, h * 0.8),
        heap,
        h * 0.2 + 0.11,
        0.4,
        12,
        r,
    );
    piece
}

/// Two to five boxes on each other, smaller ones on top, each a little turned.
pub(super) fn carton_stack(r: &mut Random) -> Piece {
    let (mut w, mut d) = (r.between(0.35, 0.6), r.between(0.3, 0.5));
    let mut piece = Piece::hollow(w * 1.1, d * 1.1, 0.0);
    let mut z = 0.0;
    for _ in 0..r.count(2, 5) {
        let h = r.between(0.18, 0.4);
        let half = v(w / 2.0, d / 2.0, h / 2.0 - 0.001);
        let yaw = r.between(-0.08, 0.08);
        solid::turned_cuboid(&mut piece.mesh, v(0.0, 0.0, z + h / 2.0), half, yaw);
        z += h;
        w *= r.between(0.8, 1.0);
        d *= r.between(0.8, 1.0);
    }
    piece.height = z;
    piece.block((-piece.half).extend(0.0), piece.half.extend(z));
    piece
}
