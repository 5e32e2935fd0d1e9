//! The laws of noise, by statistics and by analytic scenes.
use super::*;
use crate::geometry::{Mesh, Pose};
use crate::world::render::DepthRenderer;
use crate::world::test_scenes::{random, sheet};

fn camera(kind: DepthKind) -> Camera {
    let mut camera = Camera::from_fov(100, 80, 1.0, 0.8, 0.0, 9.0).unwrap();
    camera.kind = kind;
    camera
}

fn measured(noise: &DepthNoise, camera: &Camera, perfect: &[f32], seed: u64) -> Vec<f32> {
    let mut image = perfect.to_vec();
    noise.apply(camera, &mut image, &mut Vec::new(), &mut random(seed));
    image
}

/// The image of a plane at z-depth `z` in front of the camera.
fn wall(camera: &Camera, z: f32) -> Vec<f32> {
    let at = |i| z * range_per_z(camera, i % camera.width, i / camera.width);
    (0..camera.pixels()).map(at).collect()
}

#[test]
fn sigma_is_the_published_law() {
    let noise = DepthNoise::preset("gaussian").unwrap();
    // By hand: 0.0012 + 0.0019 (z - 0.4)^2.
    for (z, sigma) in [(0.4, 0.0012), (1.4, 0.0031), (2.4, 0.0088), (4.4, 0.0316)] {
        assert!((noise.sigma(z) - sigma).abs() < 1e-6);
    }
    for kind in [DepthKind::Range, DepthKind::Z] {
        let camera = camera(kind);
        for (k, z) in [0.5f32, 1.0, 2.0, 4.0].into_iter().enumerate() {
            let image = measured(&noise, &camera, &wall(&camera, z), k as u64);
            let n = image.len() as f64;
            let errors = image
                .iter()
                .enumerate()
                .map(|(i, d)| f64::from(d / range_per_z(&camera, i % 100, i / 100)) - f64::from(z));
            let (sum, squares) = errors.fold((0.0, 0.0), |(s, q), e| (s + e, q + e * e));
            let sigma = f64::from(noise.sigma(z));
            // Five standard errors of the mean and of the deviation.
            assert!((sum / n).abs() < 5.0 * sigma / n.sqrt(), "bias at {z} m");
            let deviation = (squares / n).sqrt();
            assert!(
                (deviation / sigma - 1.0).abs() < 5.0 / (2.0 * n).sqrt(),
                "{kind:?} at {z} m: {deviation} for {sigma}"
            );
        }
    }
}

#[test]
fn disparity_has_exact_steps() {
    let noise = DepthNoise {
        constant: 0.0,
        growth: 0.0,
        disparity_step: 0.125,
        ..DepthNoise::preset("gaussian").unwrap()
    };
    let camera = camera(DepthKind::Z);
    let ramp: Vec<f32> = (0..camera.pixels())
        .map(|i| 0.6 + i as f32 * (7.0 / 8000.0))
        .collect();
    let image = measured(&noise, &camera, &ramp, 1);
    for (z, got) in ramp.iter().zip(&image) {
        let steps = 43.5 / f64::from(*got) / 0.125;
        assert!((steps - steps.round()).abs() < 1e-3, "{got} m");
        // Half a step of disparity, in metres: z^2 / (f b) / 16.
        assert!((got - z).abs() < 1.02 * z * z / 43.5 / 16.0 + 1e-5);
    }
    // 7 cm apart at 5 m, as Khoshelham and Elberink found.
    let mut steps: Vec<f32> = image.iter().copied().filter(|z| *z < 5.1).collect();
    steps.sort_by(f32::total_cmp);
    steps.dedup();
    let [.., before, last] = steps[..] else {
        panic!()
    };
    assert!((0.06..0.08).contains(&(last - before)), "{before} {last}");
}

#[test]
fn only_what_is_measured_changes() {
    let camera = camera(DepthKind::Range);
    let mut perfect = wall(&camera, 1.0);
    perfect[7] = f32::INFINITY;
    perfect[8] = 0.0;
    let noise = DepthNoise::preset("kinect_v1").unwrap();
    let image = measured(&noise, &camera, &perfect, 3);
    assert_eq!(image[7..9], [f32::INFINITY, 0.0]);
    assert_eq!(measured(&noise, &camera, &perfect, 3), image);
    let other = measured(&noise, &camera, &perfect, 4);
    assert!(image.iter().zip(&other).filter(|(a, b)| a != b).count() > 1000);
    // What one pixel sees changes no other's error.
    let gaussian = DepthNoise::preset("gaussian").unwrap();
    let (a, b) = (
        wall(&camera, 1.0),
        measured(&gaussian, &camera, &perfect, 5),
    );
    let a = measured(&gaussian, &camera, &a, 5);
    assert_eq!((a[..7].to_vec(), &a[9..]), (b[..7].to_vec(), &b[9..]));
    // Beyond far and nearer than near.
    let far = measured(&gaussian, &camera, &wall(&camera, 8.99 / 1.2), 6);
    assert!(far.iter().all(|d| *d <= 9.0 || *d == f32::INFINITY));
    let huge = DepthNoise {
        constant: 1.0,
        ..gaussian
    };
    let image = measured(&huge, &camera, &wall(&camera, 0.5), 7);
    assert!(image.iter().all(|d| *d >= 0.0) && image.contains(&0.0));
    // No noise at all is no change.
    let none = DepthNoise {
        constant: 0.0,
        growth: 0.0,
        ..gaussian
    };
    let z = self::camera(DepthKind::Z);
    let perfect = wall(&z, 2.5);
    assert_eq!(measured(&none, &z, &perfect, 8), perfect);
}

/// Losses alone, in an image of real triangles.
fn losses(mesh: &Mesh, camera: &Camera, pose: &Pose, noise: DepthNoise) -> (Vec<f32>, Vec<f32>) {
    let mut perfect = vec![0.0; camera.pixels()];
    DepthRenderer::new(mesh).render(camera, pose, &mut perfect);
    let noise = DepthNoise {
        constant: 0.0,
        growth: 0.0,
        disparity_step: 0.0,
        ..noise
    };
    let image = measured(&noise, camera, &perfect, 1);
    (perfect, image)
}

#[test]
fn grazing_surfaces_are_lost_beyond_the_angle_and_only_there() {
    // A floor 1 m below a level camera: the incidence of a ray is the angle between it and the vertical.
    let mut floor = Mesh::default();
    let (corner, side) = (Vec3::new(-20.0, -20.0, 0.0), 40.0);
    sheet(
        &mut floor,
        corner,
        Vec3::X * side,
        Vec3::Y * side,
        1e3,
        0.0,
        &mut random(1),
    );
    let mut camera = camera(DepthKind::Range);
    camera.far = 15.0;
    let pose = Pose::from_yaw_pitch(Vec3::Z, 0.3, 0.0);
    let noise = DepthNoise::preset("kinect_v1").unwrap();
    let (perfect, image) = losses(&floor, &camera, &pose, noise);
    let mut lost = 0;
    for v in 0..camera.height {
        for u in 0..camera.width {
            let i = v * camera.width + u;
            if perfect[i].is_infinite() {
                assert_eq!(image[i], f32::INFINITY);
                continue;
            }
            let down = (pose.rotation * camera.ray(u, v).normalize()).z.abs();
            let incidence = down.acos().to_degrees();
            if (incidence - 80.0).abs() > 0.2 {
                assert_eq!(image[i] == 0.0, incidence > 80.0, "{incidence} degrees");
            }
            lost += usize::from(image[i] == 0.0);
        }
    }
    assert!(lost > 300, "{lost}");
    let never = DepthNoise {
        max_incidence: FRAC_PI_2,
        edge_incidence: FRAC_PI_2,
        ..noise
    };
    let (perfect, image) = losses(&floor, &camera, &pose, never);
    assert!(perfect
        .iter()
        .zip(&image)
        .all(|(a, b)| a == b || (a - b).abs() < 1e-5));
}

#[test]
fn the_far_side_of_an_edge_is_lost_and_nothing_else() {
    // A wall at x = 3 whose left half (y > 0) is hidden by one at x = 1.5.
    let mut mesh = Mesh::default();
    let mut add = |x: f32, y: f32| {
        let corner = Vec3::new(x, y, -10.0);
        sheet(
            &mut mesh,
            corner,
            Vec3::Y * 10.0,
            Vec3::Z * 20.0,
            1e3,
            0.0,
            &mut random(1),
        );
    };
    add(1.5, 0.0);
    add(3.0, -10.0);
    add(3.0, 0.0);
    let camera = camera(DepthKind::Z);
    let pose = Pose::from_yaw_pitch(Vec3::new(0.0, 0.001, 0.0), 0.0, 0.0);
    let noise = DepthNoise::preset("kinect_v1").unwrap();
    let (perfect, image) = losses(&mesh, &camera, &pose, noise);
    for (i, (before, after)) in perfect.iter().zip(&image).enumerate() {
        let u = i % camera.width;
        assert!((before - if u < 50 { 1.5 } else { 3.0 }).abs() < 1e-4);
        assert_eq!(*after == 0.0, u == 50, "column {u}");
    }
}

#[test]
fn streams_of_measurements_differ_and_can_be_saved() {
    let mut disturbance = Disturbance::new(5);
    let mut numbers: Vec<u64> = (0..100)
        .map(|_| disturbance.next_stream().random())
        .collect();
    let mut again = Disturbance { seed: 5, taken: 40 };
    assert_eq!(again.next_stream().random::<u64>(), numbers[40]);
    numbers.sort_unstable();
    numbers.dedup();
    assert_eq!(numbers.len(), 100);
}

#[test]
fn values_out_of_range_are_named() {
    let preset = DepthNoise::preset("kinect_v1").unwrap();
    assert!(preset.checked().is_ok());
    let error = DepthNoise::preset("sonar").unwrap_err().to_string();
    assert!(
        error.contains("sonar") && error.contains("kinect_v1"),
        "{error}"
    );
    for (field, bad) in [
        (
            "constant",
            DepthNoise {
                constant: -1.0,
                ..preset
            },
        ),
        (
            "growth",
            DepthNoise {
                growth: f32::NAN,
                ..preset
            },
        ),
        (
            "nearest",
            DepthNoise {
                nearest: f32::INFINITY,
                ..preset
            },
        ),
        (
            "disparity_step",
            DepthNoise {
                disparity_step: -0.1,
                ..preset
            },
        ),
        (
            "focal_baseline",
            DepthNoise {
                focal_baseline: 0.0,
                ..preset
            },
        ),
        (
            "max_incidence",
            DepthNoise {
                max_incidence: 2.0,
                ..preset
            },
        ),
        (
            "edge_incidence",
            DepthNoise {
                edge_incidence: 0.0,
                ..preset
            },
        ),
    ] {
        let error = bad.checked().unwrap_err().to_string();
        assert!(error.contains(field), "{error}");
    }
}
