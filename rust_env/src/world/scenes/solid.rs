//! Solids appended to a mesh: prisms, tubes, surfaces of revolution, rings, soft and leafy things.
//! Lengths in metres; every solid is wound outwards.
use super::draw::{Draw, Random};
use crate::geometry::{Mesh, Vec3};
use glam::Vec2;
use std::f32::consts::{PI, TAU};

/// The box between two opposite corners.
pub(super) fn cuboid(mesh: &mut Mesh, min: Vec3, max: Vec3) {
    let base = [
        Vec2::new(min.x, min.y),
        Vec2::new(max.x, min.y),
        Vec2::new(max.x, max.y),
        Vec2::new(min.x, max.y),
    ];
    prism(mesh, &base, min.z, max.z);
}

/// The box of size `2 half` around `center`, turned by `yaw` about its vertical axis.
pub(super) fn turned_cuboid(mesh: &mut Mesh, center: Vec3, half: Vec3, yaw: f32) {
    let axis = Vec2::from_angle(yaw);
    let corner = |x: f32, y: f32| center.truncate() + axis.rotate(Vec2::new(x, y));
    let base = [
        corner(-half.x, -half.y),
        corner(half.x, -half.y),
        corner(half.x, half.y),
        corner(-half.x, half.y),
    ];
    prism(mesh, &base, center.z - half.z, center.z + half.z);
}

/// A vertical prism over a simple polygon (counter-clockwise, convex or not).
pub(super) fn prism(mesh: &mut Mesh, base: &[Vec2], z0: f32, z1: f32) {
    let n = base.len() as u32;
    let first = mesh.vertices.len() as u32;
    mesh.vertices.extend(base.iter().map(|p| p.extend(z0)));
    mesh.vertices.extend(base.iter().map(|p| p.extend(z1)));
    for t in triangulate(base) {
        mesh.triangles
            .push([first + t[0], first + t[2], first + t[1]]);
        mesh.triangles.push(t.map(|i| first + n + i));
    }
    for i in 0..n {
        let (a, b) = (first + i, first + (i + 1) % n);
        mesh.triangles.push([a, b, b + n]);
        mesh.triangles.push([a, b + n, a + n]);
    }
}

/// Ear clipping of a simple counter-clockwise polygon.
pub(super) fn triangulate(polygon: &[Vec2]) -> Vec<[u32; 3]> {
    let mut left: Vec<u32> = (0..polygon.len() as u32).collect();
    let mut triangles = Vec::with_capacity(polygon.len());
    let at = |i: u32| polygon[i as usize];
    while left.len() > 3 {
        let n = left.len();
        let ear = (0..n).find(|&k| {
            let [i, j, l] = [left[(k + n - 1) % n], left[k], left[(k + 1) % n]];
            let (a, b, c) = (at(i), at(j), at(l));
            (b - a).perp_dot(c - b) > 0.0
                && left.iter().all(|&m| {
                    let p = at(m);
                    m == i
                        || m == j
                        || m == l
                        || (b - a).perp_dot(p - a) < 0.0
                        || (c - b).perp_dot(p - b) < 0.0
                        || (a - c).perp_dot(p - c) < 0.0
                })
        });
        // A polygon without an ear is not simple; clipping anywhere still ends.
        let k = ear.unwrap_or(0);
        triangles.push([left[(k + n - 1) % n], left[k], left[(k + 1) % n]]);
        left.remove(k);
    }
    if let [a, b, c] = left[..] {
        triangles.push([a, b, c]);
    }
    triangles
}

/// A round bar or a cone frustum from `from` (radius `r0`) to `to` (radius `r1`), closed at both ends.
pub(super) fn tube(mesh: &mut Mesh, from: Vec3, to: Vec3, r0: f32, r1: f32, segments: u32) {
    let axis = (to - from).normalize_or(Vec3::Z);
    let (u, v) = axis.any_orthonormal_pair();
    let first = mesh.vertices.len() as u32;
    for (center, radius) in [(from, r0), (to, r1)] {
        mesh.vertices.extend((0..segments).map(|k| {
            let (s, c) = (TAU * k as f32 / segments as f32).sin_cos();
            center + (u * c + v * s) * radius
        }));
    }
    let n = segments;
    for k in 0..n {
        let (a, b) = (first + k, first + (k + 1) % n);
        mesh.triangles.push([a, b, b + n]);
        mesh.triangles.push([a, b + n, a + n]);
        if k >= 1 && k + 1 < n {
            mesh.triangles.push([first, b, a]);
            mesh.triangles.push([first + n, a + n, b + n]);
        }
    }
}

/// The surface of revolution of `profile` (radius, height above `center`) about the vertical through `center`.
/// The profile runs upwards on the outside; a point with radius 0 closes it.
pub(super) fn revolve(mesh: &mut Mesh, center: Vec3, profile: &[(f32, f32)], segments: u32) {
    sweep(mesh, profile.len(), segments, |i, k| {
        let (radius, z) = profile[i];
        let (s, c) = (TAU * k as f32 / segments as f32).sin_cos();
        (center + Vec3::new(radius * c, radius * s, z), radius < 1e-6)
    });
}

/// Rings of `segments` points, stitched; `point(ring, k)` says where and whether the whole ring is that one point.
fn sweep(mesh: &mut Mesh, rings: usize, segments: u32, point: impl Fn(usize, u32) -> (Vec3, bool)) {
    let mut below: Option<(u32, bool)> = None;
    for i in 0..rings {
        let first = mesh.vertices.len() as u32;
        let is_pole = point(i, 0).1;
        let count = if is_pole { 1 } else { segments };
        mesh.vertices.extend((0..count).map(|k| point(i, k).0));
        if let Some((start, was_pole)) = below {
            for k in 0..segments {
                let next = (k + 1) % segments;
                let (a, b) = if was_pole {
                    (start, start)
                } else {
                    (start + k, start + next)
                };
                let (d, c) = if is_pole {
                    (first, first)
                } else {
                    (first + k, first + next)
                };
                if !was_pole {
                    mesh.triangles.push([a, b, c]);
                }
                if !is_pole {
                    mesh.triangles.push([a, c, d]);
                }
            }
        }
        below = Some((first, is_pole));
    }
}

pub(super) fn cylinder(mesh: &mut Mesh, base: Vec3, radius: f32, height: f32, segments: u32) {
    let profile = [(0.0, 0.0), (radius, 0.0), (radius, height), (0.0, height)];
    revolve(mesh, base, &profile, segments);
}

/// An open vessel: outer radius from `bottom` to `top`, wall thickness `wall`.
pub(super) fn vessel(
    mesh: &mut Mesh,
    base: Vec3,
    [bottom, top]: [f32; 2],
    height: f32,
    wall: f32,
    segments: u32,
) {
    let profile = [
        (0.0, 0.0),
        (bottom, 0.0),
        (top, height),
        (top - wall, height),
        (bottom - wall, wall),
        (0.0, wall),
    ];
    revolve(mesh, base, &profile, segments);
}

/// A superellipsoid: `roundness` 1 = ellipsoid, towards 0 = box (a cushion is about 0.4).
pub(super) fn soft_box(mesh: &mut Mesh, center: Vec3, half: Vec3, roundness: f32, segments: u32) {
    let rings = (segments / 2).max(4) as usize + 1;
    let power = |x: f32| x.signum() * x.abs().powf(roundness);
    sweep(mesh, rings, segments, |i, k| {
        let (sv, cv) = (-0.5 * PI + PI * i as f32 / (rings - 1) as f32).sin_cos();
        let (su, cu) = (TAU * k as f32 / segments as f32).sin_cos();
        let is_pole = i == 0 || i + 1 == rings;
        let ring = if is_pole { 0.0 } else { power(cv) };
        let p = Vec3::new(ring * power(cu), ring * power(su), power(sv));
        (center + half * p, is_pole)
    });
}

pub(super) fn ball(mesh: &mut Mesh, center: Vec3, radius: f32, segments: u32) {
    soft_box(mesh, center, Vec3::splat(radius), 1.0, segments);
}

/// A bumpy heap with a flat underside at `base` (clothes, a bag, foliage). `bumps` = relative depth of the bumps.
pub(super) fn lump(
    mesh: &mut Mesh,
    base: Vec3,
    half: Vec2,
    height: f32,
    bumps: f32,
    segments: u32,
    random: &mut Random,
) {
    let rings = (segments / 2).max(4) as usize;
    let offsets: Vec<f32> = (0..rings as u32 * segments)
        .map(|_| 1.0 - bumps * random.between(0.0, 1.0))
        .collect();
    sweep(mesh, rings + 1, segments, |i, k| {
        let offset = if i == 0 {
            1.0
        } else {
            offsets[(i - 1) * segments as usize + k as usize]
        };
        let (s, c) = (TAU * k as f32 / segments as f32).sin_cos();
        if i == 0 {
            return (base, true);
        }
        let (sv, cv) = (0.5 * PI * (i - 1) as f32 / (rings - 1) as f32).sin_cos();
        let is_pole = i == rings;
        let ring = if is_pole { 0.0 } else { cv * offset };
        let z = sv.max(0.02 * i as f32) * height * if is_pole { 1.0 } else { offset };
        (
            base + Vec3::new(half.x * c * ring, half.y * s * ring, z),
            is_pole,
        )
    });
}

/// Part of a torus (a mug's handle, a tyre): circle of radius `major` around `center` in the plane of the unit
/// vectors `u`, `v`, from angle `from` to `to`, with bar radius `minor`.
pub(super) struct Ring {
    pub center: Vec3,
    pub u: Vec3,
    pub v: Vec3,
    pub major: f32,
    pub minor: f32,
    pub from: f32,
    pub to: f32,
}

pub(super) fn ring(mesh: &mut Mesh, r: &Ring, along: u32, around: u32) {
    let closed = (r.to - r.from - TAU).abs() < 1e-4;
    let first = mesh.vertices.len() as u32;
    let normal = r.u.cross(r.v);
    let rows = if closed { along } else { along + 1 };
    for i in 0..rows {
        let (s, c) = (r.from + (r.to - r.from) * i as f32 / along as f32).sin_cos();
        let outward = r.u * c + r.v * s;
        let middle = r.center + outward * r.major;
        mesh.vertices.extend((0..around).map(|k| {
            let (sk, ck) = (TAU * k as f32 / around as f32).sin_cos();
            middle + (outward * ck + normal * sk) * r.minor
        }));
    }
    for i in 0..along {
        let (a0, b0) = (first + i * around, first + ((i + 1) % rows) * around);
        for k in 0..around {
            let n = (k + 1) % around;
            mesh.triangles.push([a0 + k, b0 + k, b0 + n]);
            mesh.triangles.push([a0 + k, b0 + n, a0 + n]);
        }
    }
}

/// A bent leaf from `root`, growing towards heading `yaw`, rising and then drooping; a strip of triangles.
pub(super) fn leaf(mesh: &mut Mesh, root: Vec3, yaw: f32, length: f32, width: f32, droop: f32) {
    let forward = Vec2::from_angle(yaw);
    let side = forward.perp().extend(0.0);
    let first = mesh.vertices.len() as u32;
    let stations = [(0.0, 0.15), (0.3, 0.8), (0.6, 1.0), (0.85, 0.6)];
    let spine = |t: f32| root + (forward * (t * length)).extend(length * (0.8 * t - droop * t * t));
    for (t, w) in stations {
        let half = side * (0.5 * width * w);
        mesh.vertices.extend([spine(t) - half, spine(t) + half]);
    }
    mesh.vertices.push(spine(1.0));
    for i in 0..3 {
        let a = first + 2 * i;
        mesh.triangles.push([a, a + 2, a + 3]);
        mesh.triangles.push([a, a + 3, a + 1]);
    }
    mesh.triangles.push([first + 6, first + 8, first + 7]);
}
