//! Meshes for tests of the world: soups, boxes, spheres and a furnished room.
use crate::geometry::{Mesh, Pose, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

pub fn random(seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed)
}

pub fn uniform(r: &mut Pcg64Mcg, low: f32, high: f32) -> f32 {
    low + (high - low) * r.random::<f32>()
}

pub fn within(r: &mut Pcg64Mcg, low: Vec3, high: Vec3) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|i| uniform(r, low[i], high[i])))
}

/// Triangles of all sizes within [-2, 2]^3, among them needles, points and copies.
pub fn soup(triangles: usize, seed: u64) -> Mesh {
    let mut r = random(seed);
    let mut mesh = Mesh::default();
    for i in 0..triangles {
        let centre = within(&mut r, Vec3::splat(-2.0), Vec3::splat(2.0));
        let size = 10f32.powf(uniform(&mut r, -2.5, 0.3));
        let mut corner = || centre + within(&mut r, Vec3::splat(-size), Vec3::splat(size));
        let (a, b, c) = (corner(), corner(), corner());
        let n = mesh.vertices.len() as u32;
        mesh.vertices.extend(match i % 23 {
            20 => [a, a, b],
            21 => [a, a, a],
            22 => [a, b, (a + b) * 0.5],
            19 => [a, b, b + (c - b) * 1e-4],
            _ => [a, b, c],
        });
        mesh.triangles.push([n, n + 1, n + 2]);
        if i % 31 == 30 {
            mesh.triangles.push([n, n + 1, n + 2]);
        }
    }
    mesh
}

/// A bumpy parallelogram of cells no larger than `cell`.
pub fn sheet(
    mesh: &mut Mesh,
    corner: Vec3,
    a: Vec3,
    b: Vec3,
    cell: f32,
    bump: f32,
    r: &mut Pcg64Mcg,
) {
    let (na, nb) = (
        (a.length() / cell).ceil().max(1.0) as u32,
        (b.length() / cell).ceil().max(1.0) as u32,
    );
    let first = mesh.vertices.len() as u32;
    let normal = a.cross(b).normalize_or_zero();
    for j in 0..=nb {
        for i in 0..=na {
            let height = if i == 0 || j == 0 || i == na || j == nb {
                0.0
            } else {
                uniform(r, -bump, bump)
            };
            mesh.vertices.push(
                corner + a * (i as f32 / na as f32) + b * (j as f32 / nb as f32) + normal * height,
            );
        }
    }
    for j in 0..nb {
        for i in 0..na {
            let p = first + j * (na + 1) + i;
            let q = p + na + 1;
            mesh.triangles.extend([[p, p + 1, q + 1], [p, q + 1, q]]);
        }
    }
}

pub fn cuboid(mesh: &mut Mesh, low: Vec3, high: Vec3, cell: f32, bump: f32, r: &mut Pcg64Mcg) {
    let d = high - low;
    let (x, y, z) = (Vec3::X * d.x, Vec3::Y * d.y, Vec3::Z * d.z);
    sheet(mesh, low, y, x, cell, bump, r);
    sheet(mesh, low + z, x, y, cell, bump, r);
    sheet(mesh, low, x, z, cell, bump, r);
    sheet(mesh, low + y, z, x, cell, bump, r);
    sheet(mesh, low, z, y, cell, bump, r);
    sheet(mesh, low + x, y, z, cell, bump, r);
}

pub fn sphere(mesh: &mut Mesh, centre: Vec3, radius: f32, rings: u32) {
    let first = mesh.vertices.len() as u32;
    for j in 0..=rings {
        let (st, ct) = (std::f32::consts::PI * j as f32 / rings as f32).sin_cos();
        for i in 0..=2 * rings {
            let (sp, cp) =
                (std::f32::consts::PI * (i % (2 * rings)) as f32 / rings as f32).sin_cos();
            mesh.vertices
                .push(centre + radius * Vec3::new(st * cp, st * sp, ct));
        }
    }
    for j in 0..rings {
        for i in 0..2 * rings {
            let p = first + j * (2 * rings + 1) + i;
            let q = p + 2 * rings + 1;
            mesh.triangles.extend([[p, q, p + 1], [p + 1, q, q + 1]]);
        }
    }
}

/// A closed room of 5 x 4 x 2.6 m with its corner in the origin: tables, chairs and balls; `cell` sets the density.
pub fn room(cell: f32) -> Mesh {
    let mut r = random(42);
    let mut mesh = Mesh::default();
    let bump = (cell * 0.15).min(0.006);
    cuboid(
        &mut mesh,
        Vec3::ZERO,
        Vec3::new(5.0, 4.0, 2.6),
        cell,
        bump,
        &mut r,
    );
    let mut item = |low: [f32; 3], high: [f32; 3]| {
        cuboid(
            &mut mesh,
            low.into(),
            high.into(),
            cell * 0.5,
            bump * 0.5,
            &mut r,
        );
    };
    item([1.0, 1.0, 0.72], [2.4, 1.8, 0.76]);
    for (x, y) in [(1.05, 1.05), (2.29, 1.05), (1.05, 1.69), (2.29, 1.69)] {
        item([x, y, 0.0], [x + 0.06, y + 0.06, 0.72]);
    }
    item([0.01, 2.8, 0.0], [0.35, 3.9, 1.9]);
    item([3.6, 2.6, 0.1], [4.6, 3.6, 0.45]);
    item([3.6, 3.4, 0.45], [4.6, 3.6, 0.9]);
    item([4.0, 0.4, 0.0], [4.4, 0.8, 1.1]);
    for (centre, radius) in [
        ([1.6, 1.4, 0.86], 0.1),
        ([3.0, 0.6, 0.2], 0.2),
        ([2.0, 3.2, 0.25], 0.25),
    ] {
        sphere(
            &mut mesh,
            centre.into(),
            radius,
            ((radius / cell * 4.0) as u32).clamp(6, 200),
        );
    }
    mesh
}

/// Poses inside the room of [`room`], looking anywhere.
pub fn room_poses(count: usize, seed: u64) -> Vec<Pose> {
    let mut r = random(seed);
    (0..count)
        .map(|_| {
            let eye = within(&mut r, Vec3::new(0.4, 0.4, 0.3), Vec3::new(4.6, 3.6, 2.3));
            let yaw = uniform(&mut r, -3.2, 3.2);
            let pitch = uniform(&mut r, -0.9, 0.5);
            Pose::from_yaw_pitch(eye, yaw, pitch)
        })
        .collect()
}

/// Seconds that this thread has had the processor: wall-clock says little on a shared machine.
pub fn thread_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = stat.split(' ').next().and_then(|n| n.parse::<f64>().ok());
    nanoseconds.unwrap_or(0.0) * 1e-9
}

/// 14 rings of 48 views that look outwards from a sphere.
pub fn dome(anchor: Vec3, radius: f32) -> Vec<Pose> {
    let mut views = Vec::new();
    for ring in 0..14 {
        for k in 0..48 {
            let pitch = -1.4 + 2.8 * ring as f32 / 13.0;
            let yaw = k as f32 * std::f32::consts::TAU / 48.0;
            let out = Vec3::new(
                yaw.cos() * pitch.cos(),
                yaw.sin() * pitch.cos(),
                pitch.sin(),
            );
            views.push(Pose::looking_at(
                anchor + out * radius,
                anchor + out * (radius + 1.0),
            ));
        }
    }
    views
}
