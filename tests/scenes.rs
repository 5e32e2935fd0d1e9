//! Public worlds and files of the wild, as a user would point the loader at them. They are not part of the repository:
//! set NBV_GYM_SCENES to the folder that holds them, else these tests say that they were skipped.
use std::path::{Path, PathBuf};

use nbv_core::geometry::{Aabb, Vec3};
use nbv_core::world::scene::Scene;
use nbv_core::world::scenes::{load, LoadOptions};

fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("NBV_GYM_SCENES").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes"),
        PathBuf::from,
    );
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("skipped: no scenes in {}", folder.display());
    None
}

fn lenient(path: &Path) -> Scene {
    load(path, &LoadOptions::default()).unwrap()
}

fn assert_box(what: &str, found: Aabb, expected: [[f32; 3]; 2]) {
    for (found, expected) in [(found.min, expected[0]), (found.max, expected[1])] {
        let error = (found - Vec3::from(expected)).abs().max_element();
        assert!(error < 1.0e-3, "{what}: {found} instead of {expected:?}");
    }
}

struct World {
    file: &'static str,
    /// Triangles: visual as read and clean, collision as read and clean.
    triangles: [usize; 4],
    visual: [[f32; 3]; 2],
    collision: [[f32; 3]; 2],
    floor: f32,
    plane: Option<f32>,
    exploration_z: [f32; 2],
}

/// Figures from an independent reading of the same files.
const WORLDS: [World; 5] = [
    World {
        file: "turtlebot3_house/worlds/turtlebot3_house.world",
        triangles: [14991, 14891, 14927, 14895],
        visual: [[-7.575, -5.35, 0.0], [7.578, 5.35, 2.5]],
        collision: [[-7.575, -5.35, 0.0], [7.578, 5.35, 2.5]],
        floor: 0.0,
        plane: Some(0.0),
        exploration_z: [-0.1, 2.5],
    },
    World {
        file: "aws_small_house/worlds/small_house.world",
        triangles: [148404, 148400, 6691, 6677],
        visual: [[-9.5, -5.7, -0.001], [9.5, 5.7, 3.0]],
        collision: [[-9.5, -5.7, -0.04], [9.5, 5.7, 3.0]],
        floor: 0.0,
        plane: None,
        exploration_z: [-0.1, 3.0],
    },
    World {
        file: "cafe/worlds/cafe.world",
        triangles: [24176, 17261, 302, 302],
        visual: [[-5.086, -12.203, 0.0], [5.086, 12.203, 2.867]],
        collision: [[-5.09, -12.065, 0.0], [4.3, 12.11, 2.87]],
        floor: 0.1898,
        plane: Some(0.0),
        exploration_z: [0.09, 2.867],
    },
    World {
        file: "willowgarage/worlds/willowgarage.world",
        triangles: [13841, 6863, 13350, 6364],
        visual: [[-19.983, -23.794, 0.0], [38.644, 24.827, 2.845]],
        collision: [[-19.983, -20.847, 0.0], [38.644, 24.827, 2.845]],
        floor: 0.0,
        plane: Some(0.0),
        exploration_z: [-0.1, 2.845],
    },
    World {
        file: "aws_small_warehouse/worlds/no_roof_small_warehouse.world",
        triangles: [13575, 13559, 1600, 1600],
        visual: [[-6.99, -10.453, -0.09], [7.01, 10.468, 10.018]],
        collision: [[-6.99, -10.453, -0.09], [6.99, 10.453, 10.018]],
        floor: 0.0342,
        plane: None,
        exploration_z: [-0.066, 3.534],
    },
];

#[test]
fn public_worlds_load_exactly() {
    let Some(folder) = folder() else { return };
    for world in &WORLDS {
        let scene = lenient(&folder.join(world.file));
        let report = &scene.report;
        let triangles = [
            report.visual_triangles_read,
            scene.visual.triangles.len(),
            report.collision_triangles_read,
            scene.collision.triangles.len(),
        ];
        assert_eq!(triangles, world.triangles, "{}", world.file);
        assert_box(world.file, report.visual_bounds, world.visual);
        assert_box(world.file, report.collision_bounds, world.collision);
        assert_eq!(scene.ground_plane, world.plane, "{}", world.file);
        let off = (scene.floor - world.floor).abs();
        assert!(off < 1e-3, "{}: floor {}", world.file, scene.floor);
        let [low, high] = world.exploration_z;
        let mut exploration = world.visual;
        (exploration[0][2], exploration[1][2]) = (low, high);
        assert_box(world.file, scene.bounds, exploration);
        assert!(report.missing.is_empty(), "{:?}", report.missing);
        assert!(report.instances > 0 && report.load_milliseconds > 0.0);
        // The plane adds half a metre around everything.
        if world.plane.is_some() {
            let mut with_plane = world.visual;
            for (corner, step) in with_plane.iter_mut().zip([-0.5, 0.5]) {
                corner[0] += step;
                corner[1] += step;
            }
            assert_box(world.file, scene.visual.bounds(), with_plane);
        }
        // Nothing of these worlds is lost, so strictness changes nothing.
        let strict = LoadOptions {
            strict: true,
            ..LoadOptions::default()
        };
        let strict = load(&folder.join(world.file), &strict).unwrap();
        assert_eq!(strict.visual, scene.visual);
    }
}

#[test]
fn malformed_files_are_read_or_named() {
    let Some(folder) = folder() else { return };
    let folder = folder.join("malformed");
    let path = |name: &str| folder.join(name);
    let error = |name: &str| {
        let error = load(&path(name), &LoadOptions::default()).unwrap_err();
        error.to_string()
    };
    // '--' in comments and attributes without quotes are read as Gazebo reads them.
    let doorway = lenient(&path("invalid_token_src_doorway.sdf"));
    assert!(!doorway.visual.triangles.is_empty());
    assert_eq!(doorway.report.missing.len(), 2);
    let mended = |scene: &Scene, what| scene.report.warnings.iter().any(|w| w.contains(what));
    assert!(mended(&doorway, "comment"), "{:?}", doorway.report.warnings);
    let submarine = lenient(&path("invalid_token_submarine.sdf"));
    assert!(mended(&submarine, "quotes"));
    // Cylinders of 128 triangles and boxes of 12: two and four that are seen, one and four that are hit.
    assert_eq!(submarine.visual.triangles.len(), 304);
    assert_eq!(submarine.collision.triangles.len(), 176);
    // The pit parses, but holds nothing except a height map.
    let pit = error("late_xml_declaration_lunar_pit.sdf");
    assert!(
        pit.contains("heightmap") && pit.contains("line 33"),
        "{pit}"
    );
    let book = error("truncated_aws_BookB_01_visual.DAE");
    assert!(book.contains("never closed"), "{book}");
}

#[test]
fn objects_load() {
    let Some(folder) = folder() else { return };
    let folder = folder.join("objects");
    let spot = lenient(&folder.join("spot.obj"));
    assert_eq!(spot.visual.triangles.len(), 5856);
    assert_eq!(spot.visual.vertices.len(), 2930);
    // Euler's formula: a closed surface without handles.
    assert_eq!(2930 + 5856 - 5856 * 3 / 2, 2);
    let box_ = lenient(&folder.join("ycb/003_cracker_box_textured.gltf"));
    assert_eq!(box_.report.visual_triangles_read, 16384);
    // min and max of the position accessor, y up turned to z up.
    let expected = [[-0.0488, -0.0962, -0.0032], [0.0230, 0.0679, 0.2102]];
    assert_box("cracker box", box_.report.visual_bounds, expected);
    for name in [
        "004_sugar_box",
        "005_tomato_soup_can",
        "006_mustard_bottle",
        "009_gelatin_box",
        "010_potted_meat_can",
    ] {
        let scene = lenient(&folder.join(format!("ycb/{name}_textured.gltf")));
        assert_eq!(scene.report.visual_triangles_read, 16384, "{name}");
        assert!(scene.report.warnings.is_empty());
        // The model file names its mesh below a package that is not installed: the collision shape stands in.
        let model = lenient(&folder.join(format!("ycb/{name}.sdf")));
        assert_eq!(model.report.missing.len(), 1, "{:?}", model.report);
        assert!(!model.visual.triangles.is_empty());
    }
}

/// Every mesh of every world on its own, with both readings of the up axis.
#[test]
fn every_mesh_of_the_worlds_loads() {
    let Some(folder) = folder() else { return };
    let honour = LoadOptions {
        honour_up_axis: true,
        ..LoadOptions::default()
    };
    let mut found = 0;
    let mut pending = vec![folder];
    while let Some(folder) = pending.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
            if path.is_dir() && !path.ends_with("malformed") {
                pending.push(path);
            } else if extension.as_deref() == Some("dae")
                && !path.to_string_lossy().contains("malformed")
            {
                found += 1;
                let scene = lenient(&path);
                let turned = load(&path, &honour).unwrap();
                // All these files say Z_UP, so the tag changes nothing.
                assert_eq!(scene.visual, turned.visual, "{}", path.display());
            }
        }
    }
    assert!(found > 100, "{found}");
}
