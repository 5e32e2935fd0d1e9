//! Scenes with all that belongs to them, and the world of an episode.
use super::ground_truth::GroundTruth;
use super::scene::Scene;
use super::*;
use crate::geometry::Vec2;
use crate::geometry::{Aabb, Mesh};
use crate::world::test_scenes::*;
use bodies::{PushedBox, Walker};
use ground_truth::Sight;

fn assets_of(mesh: Mesh) -> Arc<SceneAssets> {
    let scene = Scene {
        bounds: mesh.bounds(),
        visual: mesh,
        ..Scene::default()
    };
    Arc::new(SceneAssets::new(scene).unwrap())
}

#[test]
fn follows_looks_and_keeps_time() {
    let assets = assets_of(room(0.3));
    let robot = Robot::flying(0.2, 0.5, 1.0).unwrap();
    let start = Pose::from_yaw_pitch(Vec3::new(2.8, 1.8, 1.4), 0.0, 0.0);
    let mut world = World::new(&assets, &robot, start);
    // One metre at 0.5 m/s; the quarter turn is done before that.
    let goal = Pose::from_yaw_pitch(Vec3::new(3.8, 1.8, 1.4), 1.5, 0.0);
    let motion = world.follow(&[goal.translation], &goal);
    assert!(!motion.contact && (world.time() - 2.0).abs() < 1e-5);
    assert_eq!(world.pose(), goal);
    // Through the wall: stopped by it, and turned on the spot.
    let beyond = Pose::from_yaw_pitch(Vec3::new(6.0, 1.8, 1.4), 0.0, 0.0);
    let mut copy = world.clone();
    let motion = world.follow(&[beyond.translation], &beyond);
    assert!(
        motion.contact && (4.78..4.81).contains(&world.pose().translation.x),
        "{motion:?}"
    );
    assert_eq!(world.pose().rotation, beyond.rotation);
    assert_eq!(copy.follow(&[beyond.translation], &beyond), motion);
    assert_eq!((copy.pose(), copy.time()), (world.pose(), world.time()));
    let camera = Camera::from_fov(9, 9, 0.1, 0.1, 0.0, 4.0).unwrap();
    let mut image = [0.0; 81];
    world.look(&camera, &mut image);
    assert!(image.iter().all(|d| (0.18..0.23).contains(d)), "{image:?}");
}

#[test]
fn a_walker_is_seen_and_met() {
    let mut mesh = Mesh::default();
    let high = Vec3::new(8.0, 6.0, 3.0);
    cuboid(&mut mesh, Vec3::ZERO, high, 1.0, 0.0, &mut random(1));
    let assets = assets_of(mesh);
    let robot = Robot::flying(0.2, 0.5, 1.0).unwrap();
    let start = Pose::from_yaw_pitch(Vec3::new(1.0, 3.0, 1.2), 0.0, 0.0);
    let path = vec![Vec2::new(4.0, 1.0), Vec2::new(4.0, 5.0)];
    let walker = Walker::new(path, false, 1.0, 0.3, 1.8).unwrap();
    let size = Vec3::splat(0.5);
    let pushed = PushedBox::new(size, 60.0, Vec3::new(1.0, 5.0, 0.25), 0.0).unwrap();
    let bodies = Bodies::new(vec![walker], vec![pushed], true);
    let mut world = World::new(&assets, &robot, start).with_bodies(bodies);
    let camera = Camera::from_fov(64, 48, 1.2, 0.9, 0.0, 10.0).unwrap();
    let mut image = vec![0.0; camera.pixels()];
    let nearest = |image: &[f32]| image.iter().copied().fold(f32::INFINITY, f32::min);
    world.look(&camera, &mut image);
    let middle = 24 * 64 + 32;
    assert!((image[middle] - 7.0).abs() < 0.01, "{}", image[middle]);
    // Two seconds later the walker stands in the way, 3 m ahead less the radius.
    let turned = Pose::new(start.translation, start.rotation);
    world.follow(
        &[start.translation],
        &Pose::from_yaw_pitch(start.translation, 2.0, 0.0),
    );
    world.follow(&[start.translation], &turned);
    let y = world.bodies().walkers[0].position().y;
    assert!((y - 5.0).abs() < 0.02 && (world.time() - 4.0).abs() < 1e-4);
    world.follow(
        &[start.translation],
        &Pose::from_yaw_pitch(start.translation, 1.0, 0.0),
    );
    world.follow(&[start.translation], &turned);
    let y = world.bodies().walkers[0].position().y;
    assert!((y - 3.0).abs() < 0.02);
    world.look(&camera, &mut image);
    assert!((image[middle] - 2.7).abs() < 0.01, "{}", image[middle]);
    assert!((nearest(&image) - 2.7).abs() < 0.01);
    // A scan sees both: straight ahead the walker, to the left the box or the wall above it.
    let lidar = Lidar::new(360, 0.0, 10.0, -0.9, 0.0).unwrap();
    let mut scan = vec![0.0; 360];
    world.scan(&lidar, &mut scan);
    assert!((scan[0] - 2.7).abs() < 0.01 && (scan[90] - 1.75).abs() < 0.01);
    assert!((scan[180] - 1.0).abs() < 0.01 && (scan[270] - 3.0).abs() < 0.01);
    // It walks out of the way of nobody.
    let motion = world.follow(&[Vec3::new(3.45, 3.0, 1.2)], &turned);
    let mut copy = world.clone();
    assert!(!motion.contact, "it is gone by then");
    let to = [Vec3::new(5.0, 3.0, 1.2), Vec3::new(1.0, 5.0, 0.3)];
    assert_eq!(world.follow(&to, &turned), copy.follow(&to, &turned));
    assert_eq!(world.bodies(), copy.bodies());
}

#[test]
fn scans_measure_a_box_exactly_or_with_the_noise_asked_for() {
    let mut mesh = Mesh::default();
    let high = Vec3::new(5.0, 4.0, 2.6);
    cuboid(&mut mesh, Vec3::ZERO, high, 0.5, 0.0, &mut random(1));
    let assets = assets_of(mesh);
    let robot = Robot::flying(0.1, 0.5, 1.0).unwrap();
    let at = Vec3::new(2.0, 1.5, 1.0);
    for (yaw, pitch) in [(0.0f32, 0.0), (0.7, -0.4), (-2.5, 0.9)] {
        let pose = Pose::from_yaw_pitch(at, yaw, pitch);
        let mut world = World::new(&assets, &robot, pose);
        let lidar = Lidar::new(720, 0.2, 3.2, 0.5, 0.0).unwrap();
        let mut scan = vec![f32::NAN; 720];
        world.scan(&lidar, &mut scan);
        let truth: Vec<f32> = (0..720)
            .map(|i| {
                let bearing = f64::from(yaw) + std::f64::consts::TAU * f64::from(i) / 720.0;
                let (sin, cos) = bearing.sin_cos();
                let x = if cos > 0.0 { 3.0 } else { 2.0 } / cos.abs();
                let y = if sin > 0.0 { 2.5 } else { 1.5 } / sin.abs();
                x.min(y) as f32
            })
            .collect();
        for (i, (got, want)) in scan.iter().zip(&truth).enumerate() {
            let near_limit = (want - 3.2).abs() < 1e-4;
            let expected = if *want > 3.2 { f32::INFINITY } else { *want };
            assert!(
                near_limit || got == &expected || (got - want).abs() < 1e-4,
                "ray {i}: {got} {want}"
            );
        }
        assert!(scan.contains(&f32::INFINITY));
        let noisy = Lidar {
            sigma: 0.02,
            range: 10.0,
            ..lidar
        };
        let mut world = world.with_noise(None, 7);
        let mut again = world.clone();
        let (mut sum, mut squares, mut other) = (0.0, 0.0, vec![0.0; 720]);
        for _ in 0..10 {
            world.scan(&noisy, &mut scan);
            again.scan(&noisy, &mut other);
            assert_eq!(scan, other);
            for (got, want) in scan.iter().zip(&truth) {
                let e = f64::from(got - want);
                sum += e;
                squares += e * e;
            }
        }
        let n = 7200.0f64;
        assert!((sum / n).abs() < 5.0 * 0.02 / n.sqrt());
        assert!(((squares / n).sqrt() / 0.02 - 1.0).abs() < 5.0 / (2.0 * n).sqrt());
    }
    for (rays, near, range, mount, sigma) in [
        (0, 0.0, 1.0, 0.0, 0.0),
        (1 << 17, 0.0, 1.0, 0.0, 0.0),
        (4, 1.0, 1.0, 0.0, 0.0),
        (4, 0.0, f64::NAN, 0.0, 0.0),
        (4, 0.0, 1.0, f64::INFINITY, 0.0),
        (4, 0.0, 1.0, 0.0, -1.0),
    ] {
        assert!(Lidar::new(rays, near, range, mount, sigma).is_err());
    }
}

#[test]
fn noise_comes_after_rendering_and_repeats_itself() {
    let assets = assets_of(room(0.4));
    let robot = Robot::flying(0.1, 0.5, 1.0).unwrap();
    let pose = Pose::from_yaw_pitch(Vec3::new(2.8, 1.8, 1.4), 0.5, -0.2);
    let camera = Camera::from_fov(64, 48, 1.2, 0.9, 0.0, 4.0).unwrap();
    let perfect = World::new(&assets, &robot, pose);
    let noise = DepthNoise::preset("gaussian").unwrap();
    let shoot = |world: &World| {
        let mut world = world.clone();
        let mut images = vec![0.0; 2 * camera.pixels()];
        for image in images.chunks_exact_mut(camera.pixels()) {
            world.look(&camera, image);
        }
        images
    };
    let clean = shoot(&perfect);
    let noisy = perfect.clone().with_noise(Some(noise), 3);
    let images = shoot(&noisy);
    assert_eq!(images, shoot(&noisy));
    assert_eq!(clean, shoot(&perfect.clone().with_noise(None, 3)));
    assert_ne!(images, shoot(&perfect.with_noise(Some(noise), 4)));
    let (first, second) = images.split_at(camera.pixels());
    assert_ne!(first, second);
    for (got, want) in images.iter().zip(&clean) {
        assert!((got - want).abs() < 6.0 * noise.sigma(*want) || got == want);
    }
}

#[test]
fn scenes_are_read_once_and_again_when_the_file_changes() {
    let open = |source: &SceneSource| SceneAssets::open(source);
    let room = |seed| SceneSource::Generated {
        kind: "room".into(),
        seed,
    };
    assert!(Arc::ptr_eq(
        &open(&room(3)).unwrap(),
        &open(&room(3)).unwrap()
    ));
    assert!(!Arc::ptr_eq(
        &open(&room(3)).unwrap(),
        &open(&room(4)).unwrap()
    ));
    assert!(open(&SceneSource::Generated {
        kind: "no such kind".into(),
        seed: 0
    })
    .is_err());
    assert!(open(&SceneSource::File("no such file.obj".into())).is_err());
    let path = std::env::temp_dir().join(format!("nbv_gym_cache_test_{}.obj", std::process::id()));
    let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    std::fs::write(&path, triangle).unwrap();
    let source = SceneSource::File(path.clone());
    let first = open(&source).unwrap();
    assert!(Arc::ptr_eq(&first, &open(&source).unwrap()));
    std::fs::write(&path, format!("{triangle}v 0 0 1\nf 1 2 4\n")).unwrap();
    let second = open(&source).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(
        (
            first.scene.visual.triangles.len(),
            second.scene.visual.triangles.len()
        ),
        (1, 2)
    );
}

#[test]
fn what_a_reset_costs() {
    // Generated rooms are built on reset: nothing here may take long.
    for kind in scenes::KINDS {
        let mut report = Vec::new();
        for seed in 0..3 {
            let begin = thread_seconds();
            let scene = scenes::generate(kind, seed).unwrap();
            let generated = thread_seconds();
            let triangles = scene.visual.triangles.len();
            let assets = SceneAssets::new(scene).unwrap();
            let built = thread_seconds();
            let Some((position, _)) = placement::dome_anchor(&assets.starts, &assets.shape) else {
                panic!("{kind}:{seed} has no start");
            };
            let positions = assets.reachable_positions(position, 0.2);
            let flooded = thread_seconds();
            let camera = Camera::from_fov(64, 48, 1.3, 1.0, 0.0, 4.0).unwrap();
            let bounds = assets.scene.bounds;
            let truth = |sight: &Sight| {
                GroundTruth::new(
                    &assets.scene.visual,
                    &assets.renderer,
                    &bounds,
                    0.1,
                    4.0,
                    &camera,
                    sight,
                )
                .unwrap()
            };
            let free = truth(&Sight::Positions(&positions));
            let seen = thread_seconds();
            let views = test_scenes::dome(position, 0.6);
            let dome = truth(&Sight::Views(&views));
            let end = thread_seconds();
            let all = assets.surface_voxels(0.1).unwrap().len();
            report.push(format!(
                "{kind}:{seed} {triangles} triangles, ms: generate {:.0}, build {:.0}, flood of {} {:.0}, free sight {:.0}, dome sight {:.0}; voxels: {all}, free {}, dome {}",
                1e3 * (generated - begin), 1e3 * (built - generated), positions.len(), 1e3 * (flooded - built),
                1e3 * (seen - flooded), 1e3 * (end - seen), free.count(), dome.count()
            ));
            assert!(dome.count() > 0 && dome.count() <= all as u64 && free.count() <= all as u64);
            // A generous limit: machines may be slow and busy.
            assert!(end - begin < 20.0);
        }
        eprintln!("{}", report.join("\n"));
    }
}

/// The public worlds: where our starts are against verified free ones.
#[test]
fn starts_lie_in_the_public_buildings() {
    let folder = std::env::var("NBV_GYM_SCENES").unwrap_or_else(|_| "../shared/scenes".into());
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    if !root.join("index.json").exists() {
        eprintln!("skipped: no scenes at {}", root.display());
        return;
    }
    let worlds = [
        (
            "turtlebot3_house/worlds/turtlebot3_house.world",
            [[-2.15, 0.94], [6.49, -4.46], [0.85, 1.75]],
        ),
        (
            "aws_small_house/worlds/small_house.world",
            [[3.5, 1.0], [-8.86, -4.91], [-4.36, -0.32]],
        ),
    ];
    for (file, verified) in worlds {
        let assets = SceneAssets::open(&SceneSource::File(root.join(file))).unwrap();
        assert!(assets.starts.len() > 10, "{file}: {:?}", assets.starts);
        let z = assets.scene.floor + placement::HEIGHT;
        let connected: Vec<Vec3> = verified
            .iter()
            .flat_map(|[x, y]| assets.reachable_positions(Vec3::new(*x, *y, z), 0.15))
            .collect();
        // From the verified starts one can float to nearly all of ours (some rooms are closed).
        let near = assets
            .starts
            .iter()
            .filter(|(p, _)| connected.iter().any(|q| q.distance(*p) < 0.5))
            .count();
        eprintln!(
            "{file}: {} starts, {near} reachable from the verified ones",
            assets.starts.len()
        );
        assert!(
            near * 10 >= assets.starts.len() * 8,
            "{file}: {near} of {}",
            assets.starts.len()
        );
        let inside = Aabb::new(assets.scene.bounds.min + 0.2, assets.scene.bounds.max);
        assert!(assets.starts.iter().all(|(p, _)| inside.contains(*p)));
    }
}
