//! What each target does with its bytes: read them, and check what every reader promises of what it gives back.
pub mod scene_entry;
pub mod snapshot;

use nbv_core::belief::octree::SensorModel;
use nbv_core::belief::{nbvmap as map_file, octomap_file};
use nbv_core::world::scene::Scene;
use nbv_core::world::scenes::{load, load_bytes, LoadOptions};
use std::path::Path;

/// Few triangles, so that one execution stays short; the limits themselves are tested with them.
fn options() -> LoadOptions {
    LoadOptions {
        max_triangles: 20_000,
        ..LoadOptions::default()
    }
}

/// A mesh file; its name says which.
pub fn mesh(name: &str, data: &[u8]) {
    match load_bytes(Path::new(name), data.to_vec(), &options()) {
        Ok(scene) => sound(&scene),
        // A panic that was caught is a fault all the same.
        Err(error) => assert!(!error.to_string().contains("the parser failed"), "{error}"),
    }
}

/// An SDF world in an empty folder.
pub fn world(data: &[u8]) {
    let folder = std::env::temp_dir().join(format!("nbv_gym_fuzz_{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder to write to");
    let path = folder.join("fuzz.world");
    std::fs::write(&path, data).expect("room for one file");
    let outcome = load(&path, &options());
    let _ = std::fs::remove_dir_all(&folder);
    match outcome {
        Ok(scene) => sound(&scene),
        Err(error) => assert!(!error.to_string().contains("the parser failed"), "{error}"),
    }
}

fn sound(scene: &Scene) {
    for mesh in [&scene.visual, &scene.collision] {
        assert!(mesh.vertices.iter().all(|v| v.is_finite()));
        let count = mesh.vertices.len() as u32;
        assert!(mesh.triangles.iter().flatten().all(|i| *i < count));
    }
    assert!(scene.bounds.min.cmple(scene.bounds.max).all());
    assert!(scene.floor.is_finite());
}

/// An OctoMap file; what could be read is written and read again, and is the same.
pub fn map(data: &[u8]) {
    let (path, sensor) = (Path::new("fuzz"), SensorModel::default());
    let Ok(map) = octomap_file::parse(path, data, sensor) else {
        return;
    };
    // A short file may hold the largest map that is permitted; counting it takes longer than it is worth here.
    if map.num_known() > 1_000_000 {
        return;
    }
    let (known, occupied, entropy, information) = map.recount();
    assert_eq!((known, occupied), (map.num_known(), map.num_occupied()));
    assert!(entropy.is_finite() && information.is_finite());
    if known < 100_000 {
        let again = octomap_file::parse(path, &octomap_file::serialise(&map, false), sensor)
            .expect("what we write can be read");
        assert_eq!(again.num_known(), known);
    }
}

/// Our own map file, with its checksums made right.
pub fn nbvmap(data: &[u8]) {
    let mut bytes = data.to_vec();
    map_file::reseal(&mut bytes);
    let Ok(map) = map_file::parse(&bytes, None) else {
        return;
    };
    let (known, occupied, entropy, information) = map.recount();
    assert_eq!((known, occupied), (map.num_known(), map.num_occupied()));
    assert!(entropy.is_finite() && information.is_finite());
    let written = map_file::serialise(&map);
    let again = map_file::parse(&written, None).expect("what we write can be read");
    assert!(map_file::serialise(&again) == written);
}
