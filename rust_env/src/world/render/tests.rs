//! Every kernel of every instruction set against all triangles in f64.
use super::*;
use crate::camera::DepthKind;
use crate::world::bodies::{Bodies, PushedBox, Walker};
use crate::world::test_scenes::*;
use glam::{DMat3, DQuat, DVec3};

/// Distance along the unit vector `direction` to the first of all triangles, in f64 and without a hierarchy.
fn brute_force(mesh: &Mesh, origin: DVec3, direction: DVec3) -> f64 {
    let mut nearest = f64::INFINITY;
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t).map(|p| p.as_dvec3());
        let (e1, e2) = (b - a, c - a);
        // Möller and Trumbore; areas below rounding of the f32 corners are no surface.
        let p = direction.cross(e2);
        let det = e1.dot(p);
        if det.abs() < 1e-14 {
            continue;
        }
        let s = origin - a;
        let u = s.dot(p) / det;
        let q = s.cross(e1);
        let v = direction.dot(q) / det;
        let t = e2.dot(q) / det;
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < nearest {
            nearest = t;
        }
    }
    nearest
}

pub(super) fn brute_force_image(mesh: &Mesh, camera: &Camera, pose: &Pose) -> Vec<f64> {
    let rotation = DMat3::from_quat(DQuat::from_array(pose.rotation.to_array().map(f64::from)));
    let mut image = Vec::new();
    for v in 0..camera.height {
        for u in 0..camera.width {
            let ray = camera.ray(u, v).as_dvec3();
            let direction = rotation * ray.normalize();
            let range = brute_force(mesh, pose.translation.as_dvec3(), direction);
            let depth = match camera.kind {
                DepthKind::Range => range,
                DepthKind::Z => range / ray.length(),
            };
            image.push(if depth > f64::from(camera.far) {
                f64::INFINITY
            } else if depth < f64::from(camera.near) {
                0.0
            } else {
                depth
            });
        }
    }
    image
}

/// Pixels that differ by more than 1 mm; one nearer than the resolution of f32 to `near` or `far` may be on either side.
pub(super) fn count_wrong(image: &[f32], truth: &[f64], camera: &Camera) -> usize {
    let (near, far) = (f64::from(camera.near), f64::from(camera.far));
    image
        .iter()
        .zip(truth)
        .filter(|&(&got, &want)| {
            let got = f64::from(got);
            let at = |x: f64, limit: f64| (x - limit).abs() < 1e-5 * limit;
            let at_far =
                (got.is_infinite() && at(want, far)) || (want.is_infinite() && at(got, far));
            let at_near = (got == 0.0 && at(want, near)) || (want == 0.0 && at(got, near));
            // Written so that NaN counts as wrong.
            let equal = got == want || (got - want).abs() <= 1e-3 || at_far || at_near;
            !equal
        })
        .count()
}

fn camera(width: usize, height: usize, hfov: f64, near: f64, far: f64, kind: DepthKind) -> Camera {
    let vfov = 2.0 * ((hfov / 2.0).tan() * height as f64 / width as f64).atan();
    let mut camera = Camera::from_fov(width, height, hfov, vfov, near, far).unwrap();
    camera.kind = kind;
    camera
}

pub(super) const METHODS: [Method; 3] = [Method::Rays, Method::Packets, Method::Raster];

struct Case {
    name: &'static str,
    mesh: Mesh,
    camera: Camera,
    poses: Vec<Pose>,
}

fn soup_poses(count: usize, seed: u64) -> Vec<Pose> {
    let mut r = random(seed);
    (0..count)
        .map(|_| {
            let eye = within(&mut r, Vec3::splat(-3.0), Vec3::splat(3.0));
            let target = within(&mut r, Vec3::splat(-1.0), Vec3::splat(1.0));
            Pose::looking_at(eye, target)
        })
        .collect()
}

fn cases() -> Vec<Case> {
    let mut cases = vec![
        Case {
            name: "soup",
            mesh: soup(600, 11),
            camera: camera(61, 47, 1.5, 0.0, 10.0, DepthKind::Range),
            poses: soup_poses(24, 1),
        },
        Case {
            name: "soup with near and far, wide, z-depth",
            mesh: soup(600, 12),
            camera: camera(64, 48, 2.6, 0.5, 2.0, DepthKind::Z),
            poses: soup_poses(24, 2),
        },
        Case {
            name: "dense soup of small triangles",
            mesh: soup(3000, 13),
            camera: camera(96, 72, 1.0, 0.1, 6.0, DepthKind::Range),
            poses: soup_poses(6, 3),
        },
        Case {
            name: "room",
            mesh: room(0.4),
            camera: camera(160, 120, 1.57, 0.0, 20.0, DepthKind::Range),
            poses: room_poses(8, 4),
        },
        Case {
            name: "room at RL size with far inside it",
            mesh: room(0.3),
            camera: camera(64, 48, 1.57, 0.2, 2.5, DepthKind::Range),
            poses: room_poses(16, 5),
        },
    ];
    // The camera touches walls, sits in corners and in the table top, 1 cm and less from surfaces.
    let mut touching = Vec::new();
    for (i, eye) in [
        [0.0, 2.0, 1.0],
        [0.0, 0.0, 0.0],
        [2.5, 2.0, 0.0],
        [1.5, 1.4, 0.74],
        [0.014, 2.0, 1.3],
        [2.0, 2.0, 2.599],
        [5.0, 4.0, 2.6],
    ]
    .into_iter()
    .enumerate()
    {
        touching.push(Pose::from_yaw_pitch(eye.into(), 0.3 + i as f32, 0.1));
        touching.push(Pose::from_yaw_pitch(eye.into(), 0.3 - 2.0 * i as f32, -0.7));
    }
    cases.push(Case {
        name: "camera that touches surfaces",
        mesh: {
            // Exactly flat walls: bumps would move them off the camera.
            let mut r = random(1);
            let mut mesh = Mesh::default();
            cuboid(
                &mut mesh,
                Vec3::ZERO,
                Vec3::new(5.0, 4.0, 2.6),
                0.5,
                0.0,
                &mut r,
            );
            cuboid(
                &mut mesh,
                Vec3::new(1.0, 1.0, 0.72),
                Vec3::new(2.4, 1.8, 0.76),
                0.2,
                0.0,
                &mut r,
            );
            mesh
        },
        camera: camera(64, 48, 1.8, 0.0, 8.0, DepthKind::Range),
        poses: touching,
    });
    // Two huge triangles, seen along the surface.
    let mut plane = Mesh::default();
    sheet(
        &mut plane,
        Vec3::new(-50.0, -50.0, 0.0),
        Vec3::X * 100.0,
        Vec3::Y * 100.0,
        1000.0,
        0.0,
        &mut random(1),
    );
    cases.push(Case {
        name: "ground plane of two triangles",
        mesh: plane,
        camera: camera(160, 120, 1.57, 0.0, 12.0, DepthKind::Range),
        poses: (0..8)
            .map(|i| {
                Pose::from_yaw_pitch(
                    Vec3::new(0.3, 0.1, 0.02 + 0.2 * i as f32),
                    i as f32,
                    -0.1 * i as f32,
                )
            })
            .collect(),
    });
    cases
}

#[test]
fn images_agree_with_brute_force() {
    for case in cases() {
        let truth: Vec<Vec<f64>> = case
            .poses
            .iter()
            .map(|pose| brute_force_image(&case.mesh, &case.camera, pose))
            .collect();
        let seen = truth.iter().flatten().filter(|d| d.is_finite()).count();
        let pixels = case.poses.len() * case.camera.pixels();
        assert!(seen * 20 > pixels, "{}: nothing to see", case.name);
        for isa in Isa::available() {
            let renderer = DepthRenderer::with_isa(&case.mesh, isa);
            for method in METHODS {
                let mut image = vec![f32::NAN; case.camera.pixels()];
                let mut wrong = 0;
                for (pose, truth) in case.poses.iter().zip(&truth) {
                    renderer.render_by(method, &case.camera, pose, &mut image);
                    wrong += count_wrong(&image, truth, &case.camera);
                }
                let line = format!(
                    "{}: {isa:?} {method:?}: {wrong} of {pixels} pixels differ",
                    case.name
                );
                eprintln!("{line}");
                assert!(wrong as f64 <= 1e-5 * pixels as f64 + 0.5, "{line}");
            }
        }
    }
}

#[test]
fn casts_agree_with_brute_force() {
    for (mesh, seed) in [(soup(400, 3), 1), (room(0.4), 2)] {
        let renderers: Vec<_> = Isa::available()
            .into_iter()
            .map(|isa| DepthRenderer::with_isa(&mesh, isa))
            .collect();
        let mut r = random(seed);
        let mut wrong = vec![0; renderers.len()];
        let (rays, max_range) = (20_000, 3.0);
        for i in 0..rays {
            let origin = within(&mut r, Vec3::splat(-1.0), Vec3::new(4.0, 3.0, 2.0));
            let mut direction = within(&mut r, Vec3::splat(-1.0), Vec3::splat(1.0));
            if i % 7 == 0 {
                direction[i % 3] = 0.0;
            }
            if i % 11 == 0 {
                direction = Vec3::AXES[i % 3] * if i % 2 == 0 { 1.0 } else { -1.0 };
            }
            let direction = direction.normalize();
            let truth = brute_force(&mesh, origin.as_dvec3(), direction.as_dvec3());
            for (k, renderer) in renderers.iter().enumerate() {
                let ok = match renderer.cast(origin, direction, max_range) {
                    Some(t) => t <= max_range && (f64::from(t) - truth).abs() < 1e-3,
                    None => truth > f64::from(max_range) - 1e-5,
                };
                wrong[k] += usize::from(!ok);
            }
        }
        eprintln!("wrong casts by instruction set: {wrong:?} of {rays}");
        assert!(wrong.iter().all(|&n| n <= 1));
    }
}

#[test]
fn no_ray_slips_between_triangles() {
    // From inside a closed box of many flat triangles every ray hits, those through edges and corners too.
    let mut mesh = Mesh::default();
    cuboid(
        &mut mesh,
        Vec3::splat(-1.0),
        Vec3::splat(1.0),
        0.25,
        0.0,
        &mut random(1),
    );
    let camera = camera(65, 65, 1.6, 0.0, 10.0, DepthKind::Range);
    for isa in Isa::available() {
        let renderer = DepthRenderer::with_isa(&mesh, isa);
        let mut image = vec![0.0; camera.pixels()];
        for eye in [
            Vec3::ZERO,
            Vec3::new(0.25, -0.5, 0.125),
            Vec3::new(0.1, 0.2, -0.3),
        ] {
            for target in [
                Vec3::X,
                Vec3::Y,
                Vec3::new(1.0, 1.0, 0.0),
                Vec3::new(-1.0, 0.3, 0.5),
            ] {
                renderer.render(&camera, &Pose::looking_at(eye, eye + target), &mut image);
                assert!(image.iter().all(|d| d.is_finite() && *d > 0.0));
            }
            for x in -8..=8 {
                for y in -8..=8 {
                    let corner = Vec3::new(x as f32 * 0.125, y as f32 * 0.125, 1.0);
                    assert!(renderer
                        .cast(eye, (corner - eye).normalize(), 10.0)
                        .is_some());
                }
            }
        }
    }
}

#[test]
fn nothing_to_see() {
    let camera = camera(10, 7, 1.0, 0.1, 5.0, DepthKind::Range);
    let mut image = vec![0.0; 70];
    let empty = DepthRenderer::new(&Mesh::default());
    empty.render(&camera, &Pose::IDENTITY, &mut image);
    assert!(image.iter().all(|d| *d == f32::INFINITY));
    assert_eq!(empty.cast(Vec3::ZERO, Vec3::X, 10.0), None);
    let degenerate = Mesh {
        vertices: vec![Vec3::ONE, Vec3::ONE * 2.0, Vec3::ONE * 3.0],
        triangles: vec![[0, 0, 0], [0, 1, 1], [0, 1, 2]],
    };
    let lines = DepthRenderer::new(&degenerate);
    lines.render(
        &camera,
        &Pose::looking_at(Vec3::ZERO, Vec3::ONE),
        &mut image,
    );
    let full = DepthRenderer::new(&soup(50, 1));
    for bad in [Vec3::NAN, Vec3::ZERO, Vec3::splat(f32::INFINITY)] {
        assert_eq!(full.cast(Vec3::ZERO, bad, 10.0), None);
    }
    assert_eq!(full.cast(Vec3::NAN, Vec3::X, 10.0), None);
}

/// Bodies drawn over the image, and cast at, against all triangles of one merged mesh.
#[test]
fn moving_bodies_agree_with_brute_force() {
    let person = |x: f32, y: f32, radius: f64, height: f64| {
        let path = vec![crate::geometry::Vec2::new(x, y)];
        Walker::new(path, false, 1.0, radius, height).unwrap()
    };
    let mut tilted = PushedBox::new(
        Vec3::new(0.9, 0.3, 0.5),
        60.0,
        Vec3::new(3.6, 1.2, 1.1),
        0.4,
    )
    .unwrap();
    tilted.rotation = glam::Quat::from_euler(glam::EulerRot::XYZ, 0.4, 0.7, 1.1);
    let thin = PushedBox::new(
        Vec3::new(0.02, 1.0, 0.8),
        60.0,
        Vec3::new(2.2, 3.2, 0.5),
        0.3,
    )
    .unwrap();
    let bodies = Bodies::new(
        vec![person(2.0, 2.2, 0.28, 1.8), person(4.0, 3.0, 0.25, 0.5)],
        vec![tilted, thin],
        true,
    );
    let fixed = room(0.5);
    let mut merged = fixed.clone();
    merged.append(&bodies.mesh());
    let cases = [
        (
            camera(61, 47, 1.57, 0.0, 20.0, DepthKind::Range),
            room_poses(6, 9),
        ),
        (
            camera(40, 30, 2.0, 0.3, 2.0, DepthKind::Z),
            room_poses(8, 10),
        ),
        // Beside, above and inside bodies.
        (
            camera(32, 24, 1.8, 0.0, 5.0, DepthKind::Range),
            vec![
                Pose::from_yaw_pitch(Vec3::new(1.7, 2.2, 1.2), 0.0, 0.0),
                Pose::from_yaw_pitch(Vec3::new(2.0, 2.2, 2.2), 0.5, -1.5),
                Pose::from_yaw_pitch(Vec3::new(2.0, 2.2, 1.0), 0.5, 0.3),
                Pose::from_yaw_pitch(Vec3::new(3.6, 1.2, 1.1), 2.0, 0.0),
            ],
        ),
    ];
    let mut changed = 0;
    for (camera, poses) in &cases {
        for pose in poses {
            let truth = brute_force_image(&merged, camera, pose);
            for isa in Isa::available() {
                let renderer = DepthRenderer::with_isa(&fixed, isa);
                for method in METHODS {
                    let mut image = vec![f32::NAN; camera.pixels()];
                    renderer.render_by(method, camera, pose, &mut image);
                    let alone = image.clone();
                    for part in bodies.parts() {
                        renderer.render_over(&part, camera, pose, &mut image);
                    }
                    changed += image.iter().zip(&alone).filter(|(a, b)| a != b).count();
                    let wrong = count_wrong(&image, &truth, camera);
                    assert!(wrong <= 1, "{isa:?} {method:?} {pose:?}: {wrong} differ");
                }
            }
        }
    }
    assert!(changed > 10_000, "bodies were hardly in view: {changed}");
    let mut r = random(5);
    let mut wrong = 0;
    let renderers: Vec<_> = Isa::available()
        .into_iter()
        .map(|isa| DepthRenderer::with_isa(&fixed, isa))
        .collect();
    for _ in 0..5000 {
        let origin = within(&mut r, Vec3::splat(0.1), Vec3::new(4.9, 3.9, 2.5));
        let direction = within(&mut r, Vec3::splat(-1.0), Vec3::splat(1.0)).normalize();
        let truth = brute_force(&merged, origin.as_dvec3(), direction.as_dvec3());
        for renderer in &renderers {
            let mut nearest = renderer.cast(origin, direction, 3.0);
            for part in bodies.parts() {
                let limit = nearest.unwrap_or(3.0);
                nearest = renderer
                    .cast_at(&part, origin, direction, limit)
                    .or(nearest);
            }
            let ok = match nearest {
                Some(t) => (f64::from(t) - truth).abs() < 1e-3,
                None => truth > 3.0 - 1e-5,
            };
            wrong += usize::from(!ok);
        }
    }
    assert!(wrong <= 2, "{wrong} casts differ");
}
