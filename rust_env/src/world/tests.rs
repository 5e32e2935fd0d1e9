//! Scenes with all that belongs to them, and the world of an episode.
use super::ground_truth::GroundTruth;
use super::scene::Scene;
use super::*;
use crate::geometry::{Aabb, Mesh};
use crate::world::test_scenes::*;
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
