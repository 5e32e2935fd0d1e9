//! Entries of the scene cache: their payloads, behind the header with the checksum.
use nbv_core::camera::Camera;
use nbv_core::geometry::{Pose, Vec3};
use nbv_core::robot::Robot;
use nbv_core::world::ground_truth::{GroundTruth, Sight};
use nbv_core::world::lidar::Lidar;
use nbv_core::world::render::Method;
use nbv_core::world::scene_cache::{read_scene, read_truth, SceneCache};
use nbv_core::world::scenes::LoadOptions;
use nbv_core::world::{SceneAssets, World};
use std::path::Path;
use std::sync::Arc;

/// A hut of five boxes with somebody in it.
const WORLD: &str = "<sdf version='1.6'><world name='w'><model name='hut'><link name='l'>
FLOOR NORTH SOUTH EAST WEST</link></model>
<actor name='a'><script><trajectory id='0' type='walk'>
<waypoint><time>0</time><pose>1 0 0 0 0 0</pose></waypoint>
<waypoint><time>2</time><pose>-1 0 0 0 0 0</pose></waypoint></trajectory></script></actor></world></sdf>";

fn camera() -> Camera {
    Camera::from_fov(16, 12, 1.5, 1.2, 0.05, 20.0).expect("a camera")
}

/// What an episode asks of a scene that came from the cache.
pub fn scene(data: &[u8]) {
    let Ok(entry) = read_scene(data) else {
        return;
    };
    let (assets, _) = SceneAssets::of_entry(entry);
    let assets = Arc::new(assets);
    assets.stamp();
    let camera = camera();
    let mut image = vec![0.0; camera.pixels()];
    let eye = assets.starts.first().map_or(Vec3::Z, |(p, _)| *p);
    let views = [
        Pose::from_yaw_pitch(eye, 0.4, -0.2),
        Pose::looking_at(Vec3::new(-3.0, 0.5, 1.0), eye),
    ];
    for method in [Method::Rays, Method::Packets, Method::Raster] {
        for view in &views {
            assets.renderer.render_by(method, &camera, view, &mut image);
            assert!(image.iter().all(|d| !d.is_nan()));
        }
    }
    let robot = Robot::flying(0.1, 0.5, 1.5).expect("a robot");
    let lidar = Lidar::new(16, 0.0, 5.0, -0.3, 0.0).expect("a lidar");
    let mut world = World::new(&assets, &robot, views[0]);
    for view in &views {
        world.follow(&[view.translation], view);
        world.look(&camera, &mut image);
        world.scan(&lidar, &mut [0.0; 16]);
    }
    // Too large or too far: an error, in no time.
    let resolution = 0.5;
    let _ = assets.surface_voxels(resolution);
    // Sorting the surface by objects takes longest: for one entry in eight.
    if data.len().is_multiple_of(8) {
        let _ = assets.visible(&camera, &views, resolution);
    }
    let positions = assets.reachable_positions(eye, robot.radius());
    let few = &positions[..positions.len().min(20)];
    let truth = GroundTruth::new(
        &assets.scene.visual,
        &assets.renderer,
        &assets.scene.bounds,
        resolution,
        5.0,
        &camera,
        &Sight::Positions(few),
    );
    if let Ok(truth) = truth {
        assert_eq!(truth.keys().len() as u64, truth.count());
    }
}

pub fn truth(data: &[u8]) {
    let Ok(truth) = read_truth(data) else {
        return;
    };
    let keys = truth.keys();
    assert_eq!(keys.len() as u64, truth.count());
    for key in keys {
        assert!(truth.words(key >> 3).is_some());
    }
}

/// The payloads of a scene's entry and of its ground truth's.
pub fn made() -> [Vec<u8>; 2] {
    let folder = std::env::temp_dir().join(format!("nbv_gym_entry_{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder to write to");
    let world = folder.join("a.world");
    let part = |name: &str, at: [f32; 3], size: [f32; 3]| {
        let [at, size] = [at, size].map(|v| v.map(|x| x.to_string()).join(" "));
        format!("<visual name='{name}'><pose>{at} 0 0 0</pose><geometry><box><size>{size}</size></box></geometry></visual>")
    };
    let text = WORLD
        .replace("FLOOR", &part("f", [0.0, 0.0, -0.05], [4.0, 4.0, 0.1]))
        .replace("NORTH", &part("n", [0.0, 2.0, 1.2], [4.0, 0.1, 2.4]))
        .replace("SOUTH", &part("s", [0.0, -2.0, 1.2], [4.0, 0.1, 2.4]))
        .replace("EAST", &part("e", [2.0, 0.0, 1.2], [0.1, 3.8, 2.4]))
        .replace("WEST", &part("w", [-2.0, 0.5, 1.2], [0.1, 2.8, 2.4]));
    std::fs::write(&world, text).expect("room for one file");
    let cache = folder.join("cache");
    let payloads = |cache: &Path| -> Vec<Vec<u8>> {
        let entries = std::fs::read_dir(cache).into_iter().flatten().flatten();
        entries.map(|e| payload(&e.path())).collect()
    };
    let kept = Some(SceneCache::new(cache.clone(), 1 << 20));
    let assets = SceneAssets::read(&world, &LoadOptions::default(), kept).expect("a scene");
    let scene = payloads(&cache).remove(0);
    let eyes = [assets.starts[0].0];
    let make = || {
        GroundTruth::new(
            &assets.scene.visual,
            &assets.renderer,
            &assets.scene.bounds,
            0.5,
            5.0,
            &camera(),
            &Sight::Positions(&eyes),
        )
    };
    assets
        .ground_truth("task".into(), make)
        .expect("a ground truth");
    let truth = payloads(&cache).into_iter().find(|bytes| *bytes != scene);
    let _ = std::fs::remove_dir_all(&folder);
    [scene, truth.expect("an entry of the ground truth")]
}

/// What stands behind magic, build and checksum.
fn payload(path: &Path) -> Vec<u8> {
    let bytes = std::fs::read(path).expect("an entry");
    let length = u64::from_le_bytes(std::array::from_fn(|i| bytes[8 + i]));
    bytes[8 + 8 + length as usize + 16..].to_vec()
}
