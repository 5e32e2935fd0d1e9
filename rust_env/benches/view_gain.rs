//! Gains of 30 views and the planner's queries in a half-explored room of 8 x 6 x 2.7 m at 10 cm.
use criterion::{criterion_group, criterion_main, Criterion};
use nbv_core::belief::frontier::frontier_voxels;
use nbv_core::belief::gain::{view_gain, Gain};
use nbv_core::belief::integrate::Integrator;
use nbv_core::belief::octree::{Octree, SensorModel};
use nbv_core::belief::plan::{plan, reachable, travel_costs};
use nbv_core::belief::uncertainty::UncertaintyModel;
use nbv_core::belief::viewpoints::uniform_in_free_space;
use nbv_core::camera::Camera;
use nbv_core::geometry::{Aabb, Pose, Vec3};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use std::hint::black_box;

const ROOM: Aabb = Aabb {
    min: Vec3::ZERO,
    max: Vec3::new(8.0, 6.0, 2.7),
};

fn furniture() -> Vec<Aabb> {
    (0..8)
        .map(|i| {
            let (x, y) = (0.6 + 0.9 * i as f32, 0.4 + (i * 7 % 5) as f32);
            Aabb::new(
                Vec3::new(x, y, 0.0),
                Vec3::new(x + 0.5, y + 0.7, 0.4 + 0.2 * (i % 4) as f32),
            )
        })
        .collect()
}

/// Range to the room's walls or its furniture.
fn range(origin: Vec3, direction: Vec3, furniture: &[Aabb]) -> f32 {
    let slabs = |b: &Aabb| {
        let (a, c) = ((b.min - origin) / direction, (b.max - origin) / direction);
        (a.min(c).max_element(), a.max(c).min_element())
    };
    let near = furniture
        .iter()
        .map(slabs)
        .filter(|(near, far)| near < far && *near > 0.0)
        .map(|s| s.0);
    near.fold(slabs(&ROOM).1, f32::min)
}

fn explored(camera: &Camera, resolution: f64) -> Octree {
    let mut octree = Octree::new(resolution, SensorModel::default()).unwrap();
    let (model, furniture) = (UncertaintyModel::of_camera(camera), furniture());
    let mut integrator = Integrator::default();
    for i in 0..8 {
        let eye = Vec3::new(1.0 + 0.35 * i as f32, 3.0, 1.3);
        let view = Pose::from_yaw_pitch(eye, i as f32 * 0.9, -0.1);
        let depth: Vec<f32> = (0..camera.pixels())
            .map(|p| {
                range(
                    eye,
                    view.rotation * camera.ray(p % camera.width, p / camera.width).normalize(),
                    &furniture,
                )
            })
            .map(|r| if r > camera.far { f32::INFINITY } else { r })
            .collect();
        integrator
            .insert_depth(&mut octree, &depth, camera, &view, None, &model)
            .unwrap();
    }
    octree
}

fn queries(c: &mut Criterion) {
    let image = Camera::from_fov(160, 120, 1.03, 0.80, 0.0, 4.0).unwrap();
    let camera = Camera::from_fov(48, 36, 1.03, 0.80, 0.0, 4.0).unwrap();
    let octree = explored(&image, 0.1);
    let views = uniform_in_free_space(&octree, 30, &mut Pcg64Mcg::seed_from_u64(1), 0.2);
    let bounds = ROOM.grown(0.1);
    let share = octree.num_known() as f64 / (84.0 * 64.0 * 31.0);
    println!(
        "{} known voxels ({:.0} % of the bounds)",
        octree.num_known(),
        share * 100.0
    );
    for gain in Gain::ALL.into_iter().filter(|g| *g != Gain::ViewHistory) {
        c.bench_function(&format!("view_gain/{}/30x48x36/10cm", gain.name()), |b| {
            b.iter(|| {
                view_gain(
                    &octree,
                    black_box(&views),
                    &camera,
                    gain,
                    1,
                    4.0,
                    Some(bounds),
                    None,
                )
                .unwrap()
            })
        });
    }
    c.bench_function("view_gain/unknown_count/one view/10cm", |b| {
        b.iter(|| {
            view_gain(
                &octree,
                black_box(&views[..1]),
                &camera,
                Gain::UnknownCount,
                1,
                4.0,
                Some(bounds),
                None,
            )
            .unwrap()
        })
    });
    let fine = explored(&image, 0.05);
    c.bench_function("view_gain/unknown_count/30x48x36/5cm", |b| {
        b.iter(|| {
            view_gain(
                &fine,
                black_box(&views),
                &camera,
                Gain::UnknownCount,
                1,
                4.0,
                Some(bounds),
                None,
            )
            .unwrap()
        })
    });
    let goals: Vec<Vec3> = views.iter().map(|v| v.translation).collect();
    let from = Vec3::new(1.0, 3.0, 1.3);
    c.bench_function("frontier_voxels/10cm", |b| {
        b.iter(|| frontier_voxels(black_box(&octree), Some(&bounds)))
    });
    c.bench_function("travel_costs/30 goals/10cm", |b| {
        b.iter(|| travel_costs(&octree, &bounds, from, black_box(&goals), 0.2))
    });
    c.bench_function("reachable/30 goals/10cm", |b| {
        b.iter(|| reachable(&octree, &bounds, from, black_box(&goals), 0.2))
    });
    c.bench_function("plan/30 goals/10cm", |b| {
        b.iter(|| {
            goals
                .iter()
                .map(|g| plan(&octree, &bounds, from, black_box(*g), 0.2))
                .collect::<Vec<_>>()
        })
    });
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).warm_up_time(std::time::Duration::from_millis(300)).measurement_time(std::time::Duration::from_secs(1));
    targets = queries
}
criterion_main!(benches);
