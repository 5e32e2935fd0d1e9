use super::*;
use crate::belief::octree::SensorModel;
use crate::belief::viewpoints::ViewSpace;
use crate::belief::{Belief, Prior};
use crate::camera::Camera;
use crate::episode::Episode;
use crate::geometry::IVec3;
use crate::metrics::Snapshot;
use crate::robot::Robot;
use crate::setup::{MapSpec, SceneChoice};
use crate::world::bodies::BodiesSpec;
use std::collections::HashSet;

fn setup(truth: Truth, views: ViewSpace) -> Setup {
    Setup {
        scene: SceneChoice::parse("room:0").unwrap(),
        camera: Camera::from_fov(32, 24, 1.05, 0.8, 0.0, 4.0).unwrap(),
        robot: Robot::flying(0.05, 0.5, 1.5).unwrap(),
        map: MapSpec::new(0.1, 4.0, SensorModel::default()).unwrap(),
        views,
        local_map: None,
        noise: None,
        lidar: None,
        bodies: BodiesSpec::default(),
        truth,
    }
}

fn dome(truth: Truth) -> Setup {
    setup(truth, ViewSpace::dome(8, 24, 0.5, -0.5, 1.0).unwrap())
}

fn keys(truth: &GroundTruth) -> HashSet<IVec3> {
    truth.keys().into_iter().collect()
}

#[test]
fn images_of_all_views_cover_everything() {
    let setup = Arc::new(dome(Truth::Images));
    let assets = SceneAssets::open(&setup.scene.draw(&mut seeded(0))).unwrap();
    let anchor = assets.starts[0].0;
    let truth = ground_truth(&setup, &assets, anchor).unwrap();
    let all = free_views(&setup, &assets, anchor);
    let mut image = vec![0.0; setup.camera.pixels()];
    // The robot's own way of learning, from view to view, in the order of their numbers and in another one.
    let mut tour = |order: &[usize]| {
        let prior = Prior {
            bounds: assets.scene.bounds,
            start: all[order[0]],
            anchor,
        };
        let mut belief = Belief::new(&setup, prior).unwrap();
        for &i in order {
            belief.moved(&all[i], all[i]);
            assets.renderer.render(&setup.camera, &all[i], &mut image);
            belief.observe(&image).unwrap();
        }
        Snapshot::of(&belief, &truth).surface as f64 / truth.count() as f64
    };
    let forth: Vec<usize> = (0..all.len()).collect();
    assert!(all.len() > 150 && truth.count() > 2000, "{}", truth.count());
    assert_eq!(tour(&forth), 1.0);
    // The map bounds how sure it is of a voxel, and so forgets: voxels that some views hit and others pass by depend on
    // who came last.
    let back: Vec<usize> = forth.iter().rev().copied().collect();
    let scattered: Vec<usize> = forth.iter().map(|i| i * 77 % all.len()).collect();
    for order in [back, scattered] {
        let coverage = tour(&order);
        assert!((0.98..=1.0).contains(&coverage), "{coverage}");
    }
    assert!(tour(&forth[..all.len() / 2]) < 0.9);
}

#[test]
fn what_images_show_is_surface_and_nearly_all_of_it_is_in_sight() {
    let assets = SceneAssets::open(&dome(Truth::Sight).scene.draw(&mut seeded(0))).unwrap();
    let anchor = assets.starts[0].0;
    let [sight, images] =
        [Truth::Sight, Truth::Images].map(|t| ground_truth(&dome(t), &assets, anchor).unwrap());
    let (seen, shown) = (keys(&sight), keys(&images));
    let surface = assets.surface_voxels(0.1).unwrap();
    let surface: HashSet<IVec3> = surface
        .iter()
        .map(|p| (p.as_dvec3() / 0.1).floor().as_ivec3())
        .collect();
    assert!(shown.is_subset(&surface) && shown.len() < seen.len());
    let both = shown.intersection(&seen).count();
    assert!(
        both as f64 > 0.98 * shown.len() as f64,
        "{both} of {}",
        shown.len()
    );
    // Kept in memory, each under its own name.
    let again = ground_truth(&dome(Truth::Images), &assets, anchor).unwrap();
    assert!(Arc::ptr_eq(&images, &again));
}

#[test]
fn an_episode_that_visits_all_poses_covers_nearly_everything() {
    let mut episode = Episode::new(Arc::new(dome(Truth::Images)), 3).unwrap();
    for goal in episode.belief().candidates().to_vec() {
        episode.step(&goal).unwrap();
    }
    let metrics = episode.metrics();
    let coverage = metrics.after.surface as f64 / metrics.reachable_surface as f64;
    assert!((0.98..=1.0).contains(&coverage), "{coverage}");
}

#[test]
fn images_need_views_that_stay() {
    let six = ViewSpace::six_directions(0.3).unwrap();
    let error = setup(Truth::Images, six).checked().unwrap_err().to_string();
    assert!(error.contains("truth 'images'"), "{error}");
    assert!(dome(Truth::Images).checked().is_ok());
    let error = Truth::parse("map").unwrap_err().to_string();
    assert!(
        error.contains("'sight' or 'images'") && error.contains("map"),
        "{error}"
    );
}

fn seeded(seed: u64) -> rand_pcg::Pcg64Mcg {
    rand::SeedableRng::seed_from_u64(seed)
}
