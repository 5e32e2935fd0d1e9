//! SDF: how meshes are scaled and turned, quaternions, and files that are none.
use std::process::Command;

use super::collada_tests::SQUARE;
use super::gltf_tests::quad_glb;
use super::sdf_tests::{assert_box, boxed, World, BOX};
use super::{load, LoadOptions};
use crate::geometry::{Aabb, Vec3};

#[test]
fn a_pose_may_be_a_quaternion() {
    let world = World::new("quaternion");
    let turned = |pose: &str| {
        let link = boxed("", BOX).replace("<pose></pose>", pose);
        let scene = world.load(&format!("<model name='m'>{link}</model>"));
        scene.visual.bounds()
    };
    // A quarter about z, not normalised: x and y change places.
    let pose = "<pose rotation_format='quat_xyzw'>10 0 0 0 0 3 3</pose>";
    assert_box(turned(pose), [8.0, -1.0, -3.0], [12.0, 1.0, 3.0]);
    let same = "<pose rotation_format='euler_rpy' degrees='1'>10 0 0 0 0 90</pose>";
    assert_box(turned(same), [8.0, -1.0, -3.0], [12.0, 1.0, 3.0]);
    for (pose, word) in [
        (
            "<pose rotation_format='quat_xyzw'>0 0 0 0 0 0 0</pose>",
            "length 0",
        ),
        (
            "<pose rotation_format='quat_xyzw'>0 0 0 0 0 0</pose>",
            "6 numbers",
        ),
        ("<pose>0 0 0 0 0 0 1</pose>", "7 numbers"),
    ] {
        let link = boxed("", BOX).replace("<pose></pose>", pose);
        let content = format!("<model name='m'>{link}{}</model>", boxed("", BOX));
        let (error, scene) = world.strict_and_not(&content);
        assert!(error.contains(word) && error.contains("link"), "{error}");
        assert_eq!(scene.visual.triangles.len(), 12);
    }
}

#[test]
fn visual_and_collision_are_scaled_apart() {
    let world = World::new("scales");
    world.file("models/m/square.dae", SQUARE);
    let part = |tag: &str, scale: &str| {
        format!(
            "<{tag} name='x'><geometry><mesh><uri>model://m/square.dae</uri>{scale}</mesh></geometry></{tag}>"
        )
    };
    let bounds = |visual: &str, collision: &str| {
        let link = part("visual", visual) + &part("collision", collision);
        let report = world
            .load(&format!("<model name='m'>{}</model>", boxed("", &link)))
            .report;
        [report.visual_bounds, report.collision_bounds].map(|b: Aabb| [b.size(), b.min])
    };
    let [plain, same] = bounds("", "");
    assert_eq!(plain, same);
    let [visual, collision] = bounds("", "<scale>1 1 0.9</scale><!-- only here -->");
    assert_eq!(visual, plain);
    assert_eq!(collision, plain.map(|v| v * Vec3::new(1.0, 1.0, 0.9)));
    let [visual, collision] = bounds("<scale>2 3 1</scale>", "");
    let expected = plain.map(|v| v * Vec3::new(2.0, 3.0, 1.0));
    assert!((visual[0] - expected[0]).length() < 1e-6 && (visual[1] - expected[1]).length() < 1e-6);
    assert_eq!(collision, plain);
}

#[test]
fn gltf_is_turned_only_when_it_stands_alone() {
    let world = World::new("turned");
    world.file("models/m/model.sdf", "");
    let file = world.0.join("models/m/quad.glb");
    std::fs::write(&file, quad_glb()).unwrap();
    let alone = load(&file, &LoadOptions::default()).unwrap().visual;
    let inside = world
        .load(&format!(
            "<model name='m'>{}</model>",
            boxed("", "<visual name='v'><geometry><mesh><uri>model://m/quad.glb</uri></mesh></geometry></visual>")
        ))
        .visual;
    assert_eq!(alone.triangles, inside.triangles);
    let turn = |v: &Vec3| Vec3::new(v.x, -v.z, v.y);
    let turned: Vec<_> = inside.vertices.iter().map(turn).collect();
    assert_eq!(alone.vertices, turned);
    assert_ne!(alone.vertices, inside.vertices);
}

#[cfg(unix)]
#[test]
fn a_pipe_does_not_block() {
    let world = World::new("pipe");
    let pipe = world.0.join("models/m.dae");
    std::fs::create_dir_all(world.0.join("models")).unwrap();
    assert!(Command::new("mkfifo")
        .arg(&pipe)
        .status()
        .unwrap()
        .success());
    let error = load(&pipe, &LoadOptions::default())
        .unwrap_err()
        .to_string();
    assert!(error.contains("not a regular file"), "{error}");
}
