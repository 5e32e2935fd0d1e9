//! Images into the map and rays through it, per instruction set: `cargo bench --bench integrate`. Throughput is in points or rays.
use criterion::{criterion_group, criterion_main, BenchmarkId, Criterion, Throughput};
use nbv_core::belief::integrate::Integrator;
use nbv_core::belief::lockstep::Lanes;
use nbv_core::belief::octree::{Octree, SensorModel};
use nbv_core::belief::uncertainty::UncertaintyModel;
use nbv_core::camera::Camera;
use nbv_core::geometry::{Pose, Vec3};
use nbv_core::robot::Robot;
use nbv_core::world::{SceneAssets, SceneSource, World};
use std::hint::black_box;

const RANGE: f64 = 4.0;

/// Depth images of a large generated room, taken on a circle around a start, looking outwards.
struct Sequence {
    camera: Camera,
    model: UncertaintyModel,
    images: Vec<(Pose, Vec<f32>)>,
}

impl Sequence {
    fn new(width: usize, height: usize) -> Self {
        let assets = SceneAssets::open(&SceneSource::Generated {
            kind: "room".into(),
            seed: 6,
        })
        .unwrap();
        let camera = Camera::from_fov(width, height, 1.047, 0.817, 0.0, 10.0).unwrap();
        let (start, _) = assets.starts[0];
        let images = (0..12)
            .map(|i| {
                let yaw = i as f32 * std::f32::consts::TAU / 12.0;
                let eye = start + Vec3::new(yaw.cos(), yaw.sin(), 0.0) * 0.6;
                let pose = Pose::from_yaw_pitch(eye, yaw, 0.3 - 0.2 * (i % 4) as f32);
                let mut world = World::new(&assets, &Robot::flying(0.1, 0.5, 1.5).unwrap(), pose);
                let mut image = vec![0.0; camera.pixels()];
                world.look(&camera, &mut image);
                (pose, image)
            })
            .collect();
        Self {
            model: UncertaintyModel::of_camera(&camera),
            camera,
            images,
        }
    }

    fn insert(&self, integrator: &mut Integrator, resolution: f64) -> Octree {
        let mut octree = Octree::new(resolution, SensorModel::default()).unwrap();
        for (pose, image) in &self.images {
            integrator
                .insert_depth(
                    &mut octree,
                    image,
                    &self.camera,
                    pose,
                    Some(RANGE),
                    &self.model,
                )
                .unwrap();
        }
        octree
    }

    fn points(&self) -> u64 {
        (self.images.len() * self.camera.pixels()) as u64
    }
}

fn integrate(c: &mut Criterion) {
    for (width, height, resolution) in [(64, 48, 0.1), (320, 240, 0.05)] {
        let sequence = Sequence::new(width, height);
        let mut group = c.benchmark_group(format!(
            "integrate/{width}x{height}/{:.0}cm",
            resolution * 100.0
        ));
        group.throughput(Throughput::Elements(sequence.points()));
        for lanes in Lanes::available() {
            let mut integrator = Integrator::with_lanes(lanes);
            group.bench_function(BenchmarkId::from_parameter(format!("{lanes:?}")), |b| {
                b.iter(|| black_box(sequence.insert(&mut integrator, resolution)))
            });
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).warm_up_time(std::time::Duration::from_millis(300)).measurement_time(std::time::Duration::from_secs(2));
    targets = integrate
}
criterion_main!(benches);
