//! Parametric crockery: mugs, bowls, bottles, vases, pots. `n` = points per turn.
use super::draw::{Draw, Random};
use super::layout::Piece;
use super::objects::{turned, v};
use super::solid::{self, Ring};
use crate::geometry::Vec3;
use glam::Vec2;
use std::f32::consts::{PI, TAU};

pub(super) fn mug(r: &mut Random, n: u32) -> Piece {
    let (radius, h) = (r.between(0.035, 0.048), r.between(0.08, 0.11));
    let t = 0.004;
    let grip = h * 0.32;
    let mut piece = Piece::new(2.0 * radius, 2.0 * radius, h);
    piece.blocks.clear();
    piece.half = Vec2::new(radius + grip, radius);
    piece.block(v(-radius, -radius, 0.0), v(radius, radius, h));
    piece.block(v(radius, -0.01, 0.0), v(radius + grip + 0.006, 0.01, h));
    let belly = r.between(0.85, 1.0);
    let profile = [
        (0.0, 0.0),
        (radius * 0.85 * belly, 0.0),
        (radius * belly, 0.1 * h),
        (radius, 0.5 * h),
        (radius, h),
        (radius - t, h),
        (radius - t, 0.5 * h),
        (radius * belly - t, 0.12 * h),
        (0.0, 0.08 * h),
    ];
    solid::revolve(&mut piece.mesh, Vec3::ZERO, &profile, n);
    let handle = Ring {
        center: v(radius - 0.003, 0.0, h * 0.52),
        u: Vec3::X,
        v: Vec3::Z,
        major: grip,
        minor: 0.005,
        from: -0.5 * PI,
        to: 0.5 * PI,
    };
    solid::ring(&mut piece.mesh, &handle, (n / 2).max(5), (n / 3).max(5));
    piece
}

pub(super) fn glass(r: &mut Random, n: u32) -> Piece {
    let (radius, h) = (r.between(0.028, 0.04), r.between(0.09, 0.16));
    let mut piece = Piece::new(2.0 * radius, 2.0 * radius, h);
    solid::vessel(
        &mut piece.mesh,
        Vec3::ZERO,
        [radius * 0.8, radius],
        h,
        0.004,
        n,
    );
    piece
}

pub(super) fn plate(r: &mut Random, n: u32) -> Piece {
    let radius = r.between(0.09, 0.14);
    let stack = if r.chance(0.2) { r.count(2, 5) } else { 1 };
    let mut piece = Piece::new(2.0 * radius, 2.0 * radius, 0.012 + 0.012 * stack as f32);
    for i in 0..stack {
        let profile = [
            (0.0, 0.0),
            (radius * 0.6, 0.0),
            (radius, 0.018),
            (radius - 0.003, 0.024),
            (radius * 0.58, 0.006),
            (0.0, 0.006),
        ];
        solid::revolve(&mut piece.mesh, v(0.0, 0.0, 0.012 * i as f32), &profile, n);
    }
    piece
}

fn bowl_profile(radius: f32, h: f32, n: usize) -> Vec<(f32, f32)> {
    let foot = 0.4 * radius;
    let t = 0.005;
    let curve = |s: f32, inset: f32| {
        let a = 0.5 * PI * s;
        let rad = foot + (radius - foot) * a.sin() - inset;
        (rad.max(0.005), inset + (h - inset) * (1.0 - a.cos()))
    };
    let mut profile = vec![(0.0, 0.0)];
    profile.extend((0..=n).map(|i| curve(i as f32 / n as f32, 0.0)));
    profile.extend((0..=n).rev().map(|i| curve(i as f32 / n as f32, t)));
    profile.push((0.0, t));
    profile
}

pub(super) fn bowl(r: &mut Random, n: u32) -> Piece {
    let (radius, h) = (r.between(0.07, 0.14), r.between(0.05, 0.1));
    turned(&bowl_profile(radius, h, (n as usize / 4).clamp(3, 8)), n)
}

pub(super) fn fruit_bowl(r: &mut Random, n: u32) -> Piece {
    let (radius, h) = (r.between(0.12, 0.16), r.between(0.06, 0.09));
    let mut piece = turned(&bowl_profile(radius, h, 3), n);
    piece.blocks.clear();
    piece.height = h + 0.07;
    piece.block((-piece.half).extend(0.0), piece.half.extend(piece.height));
    let count = r.count(3, 6);
    for i in 0..count {
        let a = TAU * i as f32 / count as f32 + r.between(-0.2, 0.2);
        let size = r.between(0.03, 0.038);
        let ring = if i == 0 { 0.0 } else { radius * 0.52 };
        let z = if i == 0 { h * 0.9 } else { h * 0.65 };
        let center = v(ring * a.cos(), ring * a.sin(), z + 0.01);
        solid::ball(&mut piece.mesh, center, size, (n * 2 / 3).max(8));
    }
    piece
}

/// Bottles differ in shoulder, neck and size.
pub(super) fn bottle(r: &mut Random, n: u32) -> Piece {
    let (radius, h) = (r.between(0.03, 0.045), r.between(0.18, 0.33));
    let (neck, shoulder) = (r.between(0.011, 0.016), r.between(0.5, 0.72));
    let mut profile = vec![
        (0.0, 0.0),
        (radius * 0.92, 0.0),
        (radius, 0.01),
        (radius, shoulder * h),
    ];
    let steps = if n > 16 { 5 } else { 2 };
    let top = (shoulder + 0.2).min(0.9);
    profile.extend((1..=steps).map(|i| {
        let s = i as f32 / steps as f32;
        let blend = 0.5 + 0.5 * (PI * s).cos();
        (
            neck + (radius - neck) * blend,
            (shoulder + (top - shoulder) * s) * h,
        )
    }));
    profile.extend([
        (neck, 0.94 * h),
        (neck + 0.003, 0.945 * h),
        (neck + 0.003, h),
        (0.0, h),
    ]);
    turned(&profile, n)
}

pub(super) fn tin(r: &mut Random, n: u32) -> Piece {
    let (radius, h) = (r.between(0.03, 0.06), r.between(0.06, 0.18));
    let rim = 0.002;
    turned(
        &[
            (0.0, 0.0),
            (radius, 0.0),
            (radius, rim),
            (radius - rim, 2.0 * rim),
            (radius - rim, h - 2.0 * rim),
            (radius, h - rim),
            (radius, h),
            (0.0, h),
        ],
        n,
    )
}

/// A vase: belly, waist and lip, open at the top; sometimes with stalks.
pub(super) fn vase(r: &mut Random, n: u32) -> Piece {
    let (h, belly) = (r.between(0.15, 0.35), r.between(0.05, 0.09));
    let (foot, lip, waist) = (
        belly * r.between(0.5, 0.8),
        belly * r.between(0.5, 0.95),
        belly * r.between(0.3, 0.5),
    );
    let low = r.between(0.3, 0.5);
    let t = 0.005;
    let profile = [
        (0.0, 0.0),
        (foot, 0.0),
        (0.5 * (foot + belly) * 1.1, 0.5 * low * h),
        (belly, low * h),
        (0.5 * (belly + waist) * 1.08, (0.5 * low + 0.42) * h),
        (waist, 0.85 * h),
        (lip, h),
        (lip - t, h),
        (waist - t, 0.85 * h),
        (belly - t, low * h),
        (0.0, 0.03),
    ];
    let mut piece = turned(&profile, n);
    if r.chance(0.4) {
        let spread = piece.half.x.max(0.06);
        for _ in 0..r.count(3, 7) {
            let a = r.heading();
            let tilt = r.between(0.3, 1.0) * spread;
            let top = v(tilt * a.cos(), tilt * a.sin(), h + r.between(0.05, 0.2));
            solid::tube(&mut piece.mesh, v(0.0, 0.0, 0.8 * h), top, 0.003, 0.002, 4);
            solid::ball(&mut piece.mesh, top, 0.014, 6);
        }
        piece.height = h + 0.215;
        piece.half = Vec2::splat(piece.half.x.max(spread + 0.015));
        piece.blocks.clear();
        piece.block((-piece.half).extend(0.0), piece.half.extend(piece.height));
    }
    piece
}

pub(super) fn pot(r: &mut Random, n: u32) -> Piece {
    let (radius, h) = (r.between(0.08, 0.13), r.between(0.08, 0.16));
    let mut piece = Piece::new(2.0 * radius + 0.08, 2.0 * radius, h + 0.05);
    solid::vessel(&mut piece.mesh, Vec3::ZERO, [radius, radius], h, 0.004, n);
    if r.chance(0.6) {
        let lid = [
            (radius, h),
            (radius * 0.6, h + 0.015),
            (0.015, h + 0.022),
            (0.018, h + 0.045),
            (0.0, h + 0.048),
        ];
        solid::revolve(&mut piece.mesh, Vec3::ZERO, &lid, n);
    }
    for s in [-1.0f32, 1.0] {
        let handle = Ring {
            center: v(s * radius, 0.0, h * 0.8),
            u: Vec3::X * s,
            v: Vec3::Y,
            major: 0.033,
            minor: 0.006,
            from: -0.5 * PI,
            to: 0.5 * PI,
        };
        solid::ring(&mut piece.mesh, &handle, 5, 5);
    }
    piece
}

pub(super) fn kettle(r: &mut Random, n: u32) -> Piece {
    let (radius, h) = (r.between(0.07, 0.09), r.between(0.18, 0.23));
    let profile = [
        (0.0, 0.0),
        (radius, 0.0),
        (radius * 1.02, 0.2 * h),
        (radius * 0.8, 0.8 * h),
        (radius * 0.6, 0.92 * h),
        (0.015, 0.95 * h),
        (0.015, h),
        (0.0, h),
    ];
    let mut piece = turned(&profile, n);
    piece.blocks.clear();
    piece.half.x += 0.07;
    piece.block((-piece.half).extend(0.0), piece.half.extend(h));
    let handle = Ring {
        center: v(radius * 0.85, 0.0, 0.5 * h),
        u: Vec3::X,
        v: Vec3::Z,
        major: 0.3 * h,
        minor: 0.009,
        from: -0.5 * PI,
        to: 0.5 * PI,
    };
    solid::ring(&mut piece.mesh, &handle, (n / 2).max(5), (n / 3).max(5));
    let (from, to) = (
        v(-radius * 0.8, 0.0, 0.55 * h),
        v(-radius - 0.05, 0.0, 0.85 * h),
    );
    solid::tube(&mut piece.mesh, from, to, 0.02, 0.012, (n / 2).max(6));
    piece
}
