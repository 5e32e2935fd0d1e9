//! Against dense images from every viewpoint.
use super::*;
use crate::geometry::Aabb;
use crate::world::ground_truth::GroundTruth;
use crate::world::motion::SceneShape;
use crate::world::placement::reachable_positions;
use crate::world::scene::Scene;
use crate::world::test_scenes::*;

struct Fixture {
    mesh: Mesh,
    renderer: DepthRenderer,
    bounds: Aabb,
    camera: Camera,
}

impl Fixture {
    fn new(mesh: Mesh, width: usize, height: usize) -> Self {
        Self {
            renderer: DepthRenderer::new(&mesh),
            bounds: mesh.bounds().grown(0.1),
            camera: Camera::from_fov(width, height, 1.3, 1.0, 0.0, 4.0).unwrap(),
            mesh,
        }
    }

    fn truth(&self, resolution: f64, sight: &Sight) -> GroundTruth {
        GroundTruth::new(
            &self.mesh,
            &self.renderer,
            &self.bounds,
            resolution,
            4.0,
            &self.camera,
            sight,
        )
        .unwrap()
    }

    /// Voxels hit by the pixels of `camera` from `views`, with the number of hits of each.
    fn seen(
        &self,
        resolution: f64,
        camera: &Camera,
        views: &[Pose],
    ) -> std::collections::BTreeMap<[i32; 3], usize> {
        let mut seen = std::collections::BTreeMap::new();
        let mut depth = vec![0.0; camera.pixels()];
        for view in views {
            self.renderer.render(camera, view, &mut depth);
            for (i, range) in depth
                .iter()
                .enumerate()
                .filter(|(_, d)| d.is_finite() && **d > 0.0)
            {
                let point = camera.unproject(view, i % camera.width, i / camera.width, *range);
                // The map's own rule.
                let key = (point.as_dvec3() / resolution).floor().as_ivec3();
                *seen.entry(key.to_array()).or_default() += 1;
            }
        }
        seen
    }

    /// Whether a ray from some eye towards a point of a fine lattice in the voxel hits the voxel.
    fn meets(&self, resolution: f64, key: IVec3, eyes: &Eyes) -> bool {
        let corner = (key.as_dvec3() * resolution).as_vec3();
        let size = resolution as f32;
        let fine = if eyes.positions.len() < 100 { 20 } else { 7 };
        for eye in 0..eyes.positions.len() {
            let origin = eyes.positions[eye];
            for i in 0..fine * fine * fine {
                let lattice = Vec3::new(
                    (i % fine) as f32,
                    (i / fine % fine) as f32,
                    (i / fine / fine) as f32,
                );
                let point = corner + lattice * (size / (fine - 1) as f32);
                if origin.distance(point) > 4.0 + 2.0 * size {
                    break;
                }
                if !eyes.in_view(eye, point) {
                    continue;
                }
                let direction = (point - origin).normalize();
                if let Some(t) = self.renderer.cast(origin, direction, 4.0) {
                    let hit = origin + direction * t - corner;
                    if hit.cmpge(Vec3::splat(-1e-5)).all()
                        && hit.cmple(Vec3::splat(size + 1e-5)).all()
                    {
                        return true;
                    }
                }
            }
        }
        false
    }
}

fn ring(target: Vec3, radius: f32) -> Vec<Pose> {
    (0..30)
        .map(|k| {
            let a = k as f32 * std::f32::consts::TAU / 30.0;
            Pose::looking_at(
                target + Vec3::new(a.cos() * radius, a.sin() * radius, 0.4),
                target,
            )
        })
        .collect()
}

/// Of the voxels `seen` a share of `least` must be in the set, and every member must be seen by some eye.
fn compare(
    name: &str,
    f: &Fixture,
    resolution: f64,
    truth: &GroundTruth,
    seen: &std::collections::BTreeMap<[i32; 3], usize>,
    eyes: &Eyes,
    least: f64,
) {
    let keys: std::collections::BTreeSet<_> = truth.keys().iter().map(|k| k.to_array()).collect();
    assert_eq!(keys.len() as u64, truth.count());
    let found = seen.keys().filter(|k| keys.contains(*k)).count();
    let recall = found as f64 / seen.len() as f64;
    let lone: Vec<_> = keys.iter().filter(|k| !seen.contains_key(*k)).collect();
    let invisible = lone
        .iter()
        .filter(|k| !f.meets(resolution, IVec3::from_array(***k), eyes))
        .count();
    eprintln!(
        "{name}: {} voxels, {} seen densely, recall {recall:.4}; {} not seen densely, of these {invisible} not at all",
        keys.len(), seen.len(), lone.len()
    );
    assert!(recall >= least, "recall {recall}");
    // The lattice of rays is coarse: some members that one ray met it does not.
    assert!(
        invisible as f64 <= 0.02 * keys.len() as f64,
        "{invisible} invisible voxels"
    );
}

#[test]
fn dome_and_ring_against_dense_images() {
    for (name, views) in [
        ("dome", dome(Vec3::new(2.9, 1.9, 1.25), 0.6)),
        ("ring", ring(Vec3::new(1.6, 1.4, 0.8), 0.9)),
    ] {
        for (cell, resolution) in [(0.3, 0.1), (0.05, 0.1), (0.3, 0.05)] {
            let f = Fixture::new(room(cell), 64, 48);
            let truth = f.truth(resolution, &Sight::Views(&views));
            let dense = Camera {
                width: 192,
                height: 144,
                fx: f.camera.fx * 3.0,
                fy: f.camera.fy * 3.0,
                cx: 96.0,
                cy: 72.0,
                ..f.camera.clone()
            };
            let eyes = Eyes::new(&Sight::Views(&views), &f.camera, 4.0);
            // What an agent could see by going everywhere, and three times finer.
            compare(
                name,
                &f,
                resolution,
                &truth,
                &f.seen(resolution, &f.camera, &views),
                &eyes,
                0.99,
            );
            // Nine times the rays: once is enough for each kind of views.
            if (cell, resolution) == (0.3, 0.1) {
                compare(
                    name,
                    &f,
                    resolution,
                    &truth,
                    &f.seen(resolution, &dense, &views),
                    &eyes,
                    0.985,
                );
            }
        }
    }
}

#[test]
fn free_camera_against_dense_images() {
    for (cell, resolution) in [(0.3, 0.1), (0.05, 0.1)] {
        let f = Fixture::new(room(cell), 64, 48);
        let scene = Scene {
            visual: f.mesh.clone(),
            bounds: f.bounds,
            ..Scene::default()
        };
        let shape = SceneShape::new(&scene);
        let positions = reachable_positions(&shape, &f.bounds, Vec3::new(2.9, 1.9, 1.25), 0.2);
        let truth = f.truth(resolution, &Sight::Positions(&positions));
        let cube = Camera {
            width: 96,
            height: 96,
            fx: 48.0,
            fy: 48.0,
            cx: 48.0,
            cy: 48.0,
            ..f.camera.clone()
        };
        let views: Vec<Pose> = positions
            .iter()
            .step_by(3)
            .flat_map(|p| {
                [
                    Vec3::X,
                    Vec3::Y,
                    Vec3::Z,
                    Vec3::NEG_X,
                    Vec3::NEG_Y,
                    Vec3::NEG_Z,
                ]
                .map(|a| Pose::looking_at(*p, *p + a))
            })
            .collect();
        let eyes = Eyes::new(&Sight::Positions(&positions), &f.camera, 4.0);
        compare(
            "free",
            &f,
            resolution,
            &truth,
            &f.seen(resolution, &cube, &views),
            &eyes,
            0.995,
        );
    }
}

#[test]
fn sees_nothing_without_eyes_and_only_what_is_there() {
    let f = Fixture::new(room(0.4), 64, 48);
    assert_eq!(f.truth(0.1, &Sight::Views(&[])).count(), 0);
    assert_eq!(f.truth(0.1, &Sight::Positions(&[])).count(), 0);
    // One view that looks at one wall from 1 m: nothing outside its frustum.
    let view = Pose::from_yaw_pitch(Vec3::new(1.0, 2.3, 1.5), std::f32::consts::PI, 0.0);
    let truth = f.truth(0.1, &Sight::Views(&[view]));
    assert!(truth.count() > 50);
    for key in truth.keys() {
        let center = ((key.as_dvec3() + 0.5) * 0.1).as_vec3();
        let p = view.inverse().point(center);
        assert!(
            p.z > 0.0 && p.x.abs() < 0.9 * p.z + 0.2 && p.y.abs() < 0.7 * p.z + 0.2,
            "{key}"
        );
    }
}

#[test]
fn is_quick() {
    let views = dome(Vec3::new(2.9, 1.9, 1.25), 0.6);
    for (name, cell) in [("coarse", 1.0), ("fine", 0.1)] {
        let f = Fixture::new(room(cell), 64, 48);
        let scene = Scene {
            visual: f.mesh.clone(),
            bounds: f.bounds,
            ..Scene::default()
        };
        let shape = SceneShape::new(&scene);
        let begin = thread_seconds();
        let truth = f.truth(0.1, &Sight::Views(&views));
        let dome = 1e3 * (thread_seconds() - begin);
        let begin = thread_seconds();
        let positions = reachable_positions(&shape, &f.bounds, Vec3::new(2.9, 1.9, 1.25), 0.2);
        let flood = 1e3 * (thread_seconds() - begin);
        let begin = thread_seconds();
        let free = f.truth(0.1, &Sight::Positions(&positions));
        let free_time = 1e3 * (thread_seconds() - begin);
        let begin = thread_seconds();
        let surface = Surface::new(&f.mesh, &f.bounds, 0.1).unwrap();
        eprintln!(
            "{name}, {} triangles: dome {dome:.1} ms ({} voxels), flood {flood:.1} ms ({} positions), free {free_time:.1} ms ({} voxels), voxelisation {:.1} ms ({} voxels)",
            f.mesh.triangles.len(), truth.count(), positions.len(), free.count(), 1e3 * (thread_seconds() - begin), surface.voxels.len()
        );
        assert!(dome < 1e3 && free_time < 1e3);
    }
}
