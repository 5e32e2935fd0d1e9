//! SDF worlds written for the purpose: where things stand, what is found, what is refused.
use std::fs;
use std::path::{Path, PathBuf};

use super::collada_tests::SQUARE;
use super::gltf_tests::folder;
use super::{load, LoadOptions};
use crate::error::Result;
use crate::geometry::{Aabb, Vec3};
use crate::world::scene::Scene;

/// A resource folder of its own, removed at the end.
pub(super) struct World(pub PathBuf);

impl World {
    pub fn new(name: &str) -> Self {
        let world = Self(folder(name));
        fs::create_dir_all(world.0.join("worlds")).unwrap();
        world
    }

    pub fn file(&self, path: &str, text: &str) -> &Self {
        let path = self.0.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
        self
    }

    fn model(&self, name: &str, content: &str) -> &Self {
        let text = format!("<sdf version='1.6'><model name='{name}'>{content}</model></sdf>");
        self.file(&format!("models/{name}/model.sdf"), &text)
    }

    fn load_with(&self, content: &str, options: &LoadOptions) -> Result<Scene> {
        let text = format!(
            "<?xml version='1.0'?><sdf version='1.6'><world name='w'>{content}</world></sdf>"
        );
        self.file("worlds/a.world", &text);
        load(&self.0.join("worlds/a.world"), options)
    }

    pub fn load(&self, content: &str) -> Scene {
        self.load_with(content, &LoadOptions::default()).unwrap()
    }

    /// The error under `strict`, and the scene without.
    pub fn strict_and_not(&self, content: &str) -> (String, Scene) {
        let strict = LoadOptions {
            strict: true,
            ..LoadOptions::default()
        };
        let error = self.load_with(content, &strict).unwrap_err().to_string();
        (error, self.load(content))
    }
}

impl Drop for World {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// A box of 2 x 4 x 6 m.
pub(super) const BOX: &str =
    "<visual name='v'><geometry><box><size>2 4 6</size></box></geometry></visual>";

pub(super) fn boxed(pose: &str, inner: &str) -> String {
    format!("<link name='l'><pose>{pose}</pose>{inner}</link>")
}

pub(super) fn assert_box(found: Aabb, min: [f32; 3], max: [f32; 3]) {
    let error = (found.min - Vec3::from(min))
        .abs()
        .max((found.max - Vec3::from(max)).abs());
    assert!(
        error.max_element() < 1e-5,
        "{found:?} instead of {min:?} {max:?}"
    );
}

#[test]
fn poses_chain_from_model_to_visual() {
    let world = World::new("chain");
    // yaw turns x into y; roll comes first, yaw last: R = Rz Ry Rx.
    let scene = world.load(&format!(
        "<model name='m'><pose>10 0 0 0 0 1.5707963267948966</pose>
         <model name='n'><pose frame=''>1 0 0 1.5707963267948966 0 0</pose>{}</model></model>",
        boxed(
            "0 0 1 0 0 0",
            &BOX.replace(
                "<geometry>",
                "<pose degrees='true'>0 1 0 0 0 90</pose><geometry>"
            )
        )
    ));
    // visual: yaw swaps 2 and 4; (0, 1, 0), link: (0, 1, 1), n: roll turns (y, z) into (-z, y): (1, -1, 1), sizes 4 6 2;
    // m: (x, y) into (-y, x): (11, 1, 1), sizes 6 4 2.
    assert_box(scene.visual.bounds(), [8.0, -1.0, 0.0], [14.0, 3.0, 2.0]);
    assert_eq!(
        (scene.report.instances, scene.report.visual_triangles_read),
        (1, 12)
    );
    assert!(
        scene.report.warnings.is_empty(),
        "{:?}",
        scene.report.warnings
    );
}

#[test]
fn an_include_replaces_the_pose_of_its_model() {
    let world = World::new("include");
    world.model(
        "crate",
        &format!("<pose>100 0 0 0 0 0</pose>{}", boxed("0 0 3 0 0 0", BOX)),
    );
    let include = "<include><uri>model://crate</uri></include>";
    let at = |content: &str| world.load(content).visual.bounds();
    assert_box(at(include), [99.0, -2.0, 0.0], [101.0, 2.0, 6.0]);
    assert_box(
        at(&include.replace("</uri>", "</uri><pose>5 0 0 0 0 0</pose>")),
        [4.0, -2.0, 0.0],
        [6.0, 2.0, 6.0],
    );
    // The wrapper of the AWS worlds: its pose and the included model's.
    let wrapper = format!(
        "<model name='m'><static>1</static>{include}<pose frame=''>0 7 0 0 -0 0</pose></model>"
    );
    assert_box(at(&wrapper), [99.0, 5.0, 0.0], [101.0, 9.0, 6.0]);
    // Two of them, and an <include> in a link, which does not count.
    let two = format!("{include}<include><name>b</name><pose>0 0 0 0 0 0</pose><uri>model://crate</uri></include>\
        <model name='x'><link name='l'>{include}</link></model>");
    assert_eq!(world.load(&two).report.instances, 2);
}

#[test]
fn frames_may_be_named() {
    let world = World::new("frames");
    let scene = world.load(&format!(
        "<frame name='f'><pose>0 0 10 0 0 0</pose></frame>
         <model name='m' placement_frame='p'><pose relative_to='f'>0 0 1 0 0 0</pose>
         <frame name='p' attached_to='q'><pose>0 1 0 0 0 0</pose></frame>
         <link name='q'><pose>3 0 0 0 0 0</pose></link>{}</model>",
        boxed("0 0 0 0 0 0", BOX).replace("<pose>", "<pose relative_to='p'>")
    ));
    // The box is at p, and p is at z = 11.
    assert_box(scene.visual.bounds(), [-1.0, -2.0, 8.0], [1.0, 2.0, 14.0]);
    let nowhere = |frame: &str| {
        format!(
            "<model name='m'><frame name='f'><pose relative_to='f'/></frame>{}</model>",
            boxed("0 0 0 0 0 0", BOX).replace("<pose>", &format!("<pose relative_to='{frame}'>"))
                + &boxed("", BOX)
        )
    };
    for frame in ["x", "f"] {
        let (error, scene) = world.strict_and_not(&nowhere(frame));
        assert!(error.contains(&format!("frame '{frame}'")), "{error}");
        assert_eq!(scene.visual.triangles.len(), 12);
    }
}

#[test]
fn state_overrides_poses() {
    let world = World::new("state");
    let models = format!(
        "<model name='a'>{0}<model name='b'>{0}</model></model><model name='gone'>{0}</model>",
        boxed("1 0 0 0 0 0", BOX)
    );
    let state = "<state world_name='w'><model name='a'><pose>0 0 50 0 0 0</pose><link name='l'><pose>0 0 60 0 0 0</pose></link>
        <model name='b'><pose>0 0 70 0 0 0</pose><scale>1 1 0.5</scale></model></model>
        <insertions><model name='new'>LINK</model></insertions><deletions><name>gone</name></deletions></state>";
    let state = state.replace("LINK", &boxed("0 0 90 0 0 0", BOX));
    let scene = world.load(&(models + &state));
    let heights: Vec<f32> = scene.visual.vertices.iter().map(|v| v.z).collect();
    for z in [57.0, 63.0, 68.5, 71.5, 87.0, 93.0] {
        assert!(heights.contains(&z), "{z} not in {heights:?}");
    }
    assert_eq!(scene.visual.triangles.len(), 36);
}

#[test]
fn shapes_and_scales() {
    let world = World::new("shapes");
    world.file("models/m/meshes/sub folder/SQUARE.DAE", SQUARE);
    let shape = |shape: &str| {
        let scene = world.load(&format!(
            "<model name='m'><link name='l'><collision name='c'><geometry>{shape}</geometry></collision></link></model>"
        ));
        assert!(scene.visual.triangles.is_empty());
        (
            scene.report.collision_bounds,
            scene.collision.triangles.len(),
        )
    };
    for (text, half, triangles) in [
        ("<box><size>2 4 6</size></box>", [1.0, 2.0, 3.0], 12),
        (
            "<cylinder><radius> 1 </radius><length>4</length></cylinder>",
            [1.0, 1.0, 2.0],
            128,
        ),
        ("<sphere><radius>2</radius></sphere>", [2.0, 2.0, 2.0], 1280),
        (
            "<capsule><radius>1</radius><length>4</length></capsule>",
            [1.0, 1.0, 3.0],
            1024,
        ),
        (
            "<ellipsoid><radii>1 2 3</radii></ellipsoid>",
            [1.0, 2.0, 3.0],
            1280,
        ),
        (
            "<cone><radius>1</radius><length>4</length></cone>",
            [1.0, 1.0, 2.0],
            64,
        ),
        (
            "<plane><normal>1 0 0</normal><size>2 2</size></plane>",
            [0.0, 1.0, 1.0],
            2,
        ),
    ] {
        let (bounds, count) = shape(text);
        assert_eq!(count, triangles, "{text}");
        // The icosphere's vertices do not lie on the axes.
        assert!(
            (bounds.max - Vec3::from(half)).abs().max_element() < 0.08,
            "{text} {bounds:?}"
        );
        assert!(
            (bounds.min + Vec3::from(half)).abs().max_element() < 0.08,
            "{text} {bounds:?}"
        );
    }
    let mesh =
        "<mesh><uri>model://m/meshes/sub folder/SQUARE.DAE</uri><scale>-2 1 1</scale></mesh>";
    assert_box(shape(mesh).0, [-2.04, 0.0, 0.0], [-2.0, 0.02, 0.0]);
    for broken in [
        "<box><size>2 4</size></box>", "<box/>", "<cylinder><radius>-1</radius><length>1</length></cylinder>",
        "<sphere><radius>nan</radius></sphere>", "<plane><normal>0 0 0</normal></plane>",
        "<heightmap/>", "<polyline/>", "<image/>", "<mesh/>",
        "<mesh><uri>model://m/meshes/sub folder/SQUARE.DAE</uri><submesh><name>x</name></submesh></mesh>",
    ] {
        let (error, scene) = world.strict_and_not(&format!(
            "<model name='m'>{}<link name='k'><visual name='c'><geometry>{broken}</geometry></visual></link></model>",
            boxed("", BOX)
        ));
        assert!(error.contains("a.world"), "{error}");
        assert_eq!(scene.report.warnings.len(), 1, "{broken} {:?}", scene.report.warnings);
        assert_eq!(scene.visual.triangles.len(), 12);
    }
}

#[test]
fn the_ground_plane_is_infinite_and_finite() {
    let world = World::new("plane");
    let plane = "<geometry><plane><normal>0 0 1</normal><size>100 100</size></plane></geometry>";
    world.model("ground_plane", &format!(
        "<link name='l'><visual name='v'>{plane}</visual><collision name='c'>{plane}</collision></link>"));
    let content = format!(
        "<include><uri>https://fuel.gazebosim.org/1.0/OpenRobotics/models/Ground Plane</uri><pose>0 0 -1 0 0 0</pose></include>
         <model name='m'>{}</model>", boxed("0 0 3 0 0 0", BOX));
    let scene = world.load(&content);
    assert_eq!(scene.ground_plane, Some(-1.0));
    assert_box(scene.visual.bounds(), [-1.5, -2.5, -1.0], [1.5, 2.5, 6.0]);
    assert_box(
        scene.report.visual_bounds,
        [-1.0, -2.0, 0.0],
        [1.0, 2.0, 6.0],
    );
    assert_eq!(
        (
            scene.report.visual_triangles_read,
            scene.report.collision_triangles_read
        ),
        (14, 2)
    );
    assert!(scene.report.missing.is_empty());
    // Without Gazebo's models both standard includes are still understood.
    fs::remove_dir_all(world.0.join("models")).unwrap();
    let again = world.load(&(content + "<include><uri>model://sun</uri></include>"));
    assert_eq!(
        (again.ground_plane, again.visual),
        (scene.ground_plane, scene.visual)
    );
    assert!(again.report.missing.is_empty() && again.report.warnings.len() == 1);
    // A rug is no ground.
    let rug = plane.replace("100 100", "2 2");
    let scene = world.load(&format!(
        "<model name='m'><link name='l'><visual name='v'>{rug}</visual></link></model>"
    ));
    assert_eq!(scene.ground_plane, None);
    assert_box(scene.visual.bounds(), [-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]);
}

#[test]
fn files_are_found_by_every_uri() {
    let world = World::new("uris");
    world
        .file("models/m/meshes/Square.DAE", SQUARE)
        .model("m", "");
    world.file("elsewhere/other/square.dae", SQUARE);
    let options = LoadOptions {
        search_paths: vec![world.0.join("elsewhere")],
        ..LoadOptions::default()
    };
    let with = |uri: &str| {
        let mesh =
            format!("<visual name='v'><geometry><mesh><uri>{uri}</uri></mesh></geometry></visual>");
        world
            .load_with(
                &format!(
                    "<model name='m'>{}</model>",
                    boxed("", &(BOX.to_owned() + &mesh))
                ),
                &options,
            )
            .unwrap()
            .report
    };
    let absolute = format!(
        "file://{}",
        world.0.join("models/m/meshes/Square.DAE").display()
    );
    for uri in [
        "model://m/meshes/Square.DAE",
        " model://other/square.dae ",
        "file://models/m/meshes/Square.DAE",
        "file://m/meshes/Square.DAE",
        "../models/m/meshes/Square.DAE",
        "package://m/meshes/Square.DAE",
        "https://fuel.gazebosim.org/1.0/me/models/M/2/files/meshes/Square.DAE",
        &absolute,
    ] {
        let report = with(uri);
        assert_eq!(
            (report.visual_triangles_read, report.warnings.len()),
            (14, 0),
            "{uri} {:?}",
            report.warnings
        );
    }
    let report = with("model://M/Meshes/square.dae");
    assert_eq!(
        (report.visual_triangles_read, report.missing.len()),
        (14, 0)
    );
    assert!(
        report.warnings[0].contains("found only as"),
        "{:?}",
        report.warnings
    );
    // A file that exists, but outside.
    world.file("secret.dae", SQUARE);
    let secret = format!("file://{}", world.0.join("secret.dae").display());
    for uri in [
        "model://m/../../secret.dae",
        "../secret.dae",
        &secret,
        "file:///etc/hostname",
        "x://y",
    ] {
        let report = with(uri);
        assert_eq!(
            (report.visual_triangles_read, &report.missing[..]),
            (12, &[uri.to_owned()][..])
        );
        assert!(!report.warnings.is_empty());
    }
}

#[test]
fn the_highest_sdf_version_is_taken() {
    let world = World::new("versions");
    let file = |size: &str| {
        format!(
            "<sdf><model name='m'>{}</model></sdf>",
            boxed("", &BOX.replace("2 4 6", size))
        )
    };
    world
        .file("models/m/old.sdf", &file("1 1 1"))
        .file("models/m/new.sdf", &file("2 2 2"))
        .file("models/m/model.sdf", &file("3 3 3"));
    let size = |config: &str| {
        world.file("models/m/model.config", config);
        world
            .load("<include><uri>model://m</uri></include>")
            .visual
            .bounds()
            .size()
            .x
    };
    let config = "<model><sdf version='1.4'>old.sdf</sdf><sdf version='1.10'>new.sdf</sdf><sdf version='1.9'>old.sdf</sdf></model>";
    assert_eq!(size(config), 2.0);
    assert_eq!(size(&config.replace("new.sdf", "gone.sdf")), 1.0);
    assert_eq!(size(&config.replace("new.sdf", "../m/new.sdf")), 1.0);
    assert_eq!(size("<model>"), 3.0);
    // As Fuel's client keeps them.
    for version in ["2", "10"] {
        world.file(
            &format!("models/big crate/{version}/model.sdf"),
            &file(&format!("{version} 1 1")),
        );
    }
    let uri = "https://fuel.gazebosim.org/1.0/me/models/Big Crate";
    let scene = world.load(&format!("<include><uri>{uri}</uri></include>"));
    assert_eq!(scene.visual.bounds().size().x, 10.0);
}

#[test]
fn lost_parts_are_counted() {
    let world = World::new("lost");
    let visual =
        "<visual name='v'><geometry><mesh><uri>model://m/gone.dae</uri></mesh></geometry></visual>";
    let body = BOX.replace("visual", "collision");
    let link = boxed("", &(visual.to_owned() + &body));
    let (error, scene) = world.strict_and_not(&format!(
        "<model name='m'>{link}</model><model name='n'>{link}</model>"
    ));
    assert!(error.contains("model://m/gone.dae"), "{error}");
    assert_eq!(scene.report.missing, ["model://m/gone.dae"]);
    assert!(
        scene
            .report
            .warnings
            .iter()
            .any(|w| w.ends_with("(2 times)")),
        "{:?}",
        scene.report.warnings
    );
    // The collision shape is seen in place of the visual one.
    assert_eq!(scene.visual.triangles, scene.collision.triangles);
    // Broken instead of missing; the truncated file is named.
    world.file("models/m/gone.dae", &SQUARE[..SQUARE.len() / 2]);
    let (error, scene) = world.strict_and_not(&format!("<model name='m'>{link}</model>"));
    assert!(
        error.contains("gone.dae") && error.contains("XML"),
        "{error}"
    );
    assert_eq!(scene.visual.triangles.len(), 12);
    let (error, _) = world.strict_and_not(&format!(
        "<include><uri>model://none</uri></include><model name='m'>{}</model>",
        boxed("", BOX)
    ));
    assert!(error.contains("model://none"), "{error}");
}

#[test]
fn far_objects_are_dropped() {
    let world = World::new("far");
    for pose in ["0 0 343582 0 0 0", "0 0 -1000 0 0 0", "0 1e300 0 0 0 0"] {
        let (error, scene) = world.strict_and_not(&format!(
            "<model name='m'>{}{}</model>",
            boxed("", BOX),
            boxed(pose, BOX)
        ));
        assert!(
            error.contains("from the origin") || error.contains("not finite"),
            "{error}"
        );
        assert_box(scene.visual.bounds(), [-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]);
    }
    for pose in ["0 0 nan 0 0 0", "0 0 0", "a b c d e f", "0 0 1e400 0 0 0"] {
        let (error, scene) = world.strict_and_not(&format!(
            "<model name='m'>{}{}</model>",
            boxed("", BOX),
            boxed(pose, BOX)
        ));
        assert!(error.contains("<pose>"), "{error}");
        assert_eq!(scene.visual.triangles.len(), 12);
    }
}

#[test]
fn recursion_ends() {
    let world = World::new("recursion");
    let include = "<include><uri>model://loop</uri></include>";
    world.model("loop", &(boxed("", BOX) + include));
    let (error, scene) = world.strict_and_not(include);
    assert!(error.contains("levels"), "{error}");
    assert!(
        scene.report.warnings[0].contains("levels"),
        "{:?}",
        scene.report.warnings
    );
    // Two branches a level would be 2^32 models.
    world.model("loop", &format!("{}{include}{include}", boxed("", BOX)));
    let error = world
        .load_with(include, &LoadOptions::default())
        .unwrap_err()
        .to_string();
    assert!(error.contains("more than"), "{error}");
    let nested = "<model name='m'>".repeat(20_000) + &boxed("", BOX) + &"</model>".repeat(20_000);
    assert!(world.load_with(&nested, &LoadOptions::default()).is_err());
}

#[test]
fn a_world_must_hold_something() {
    let world = World::new("empty");
    for content in ["", "<light/>", "<model name='m'/>", "<include/>"] {
        assert!(
            world.load_with(content, &LoadOptions::default()).is_err(),
            "{content}"
        );
    }
    let scene = world.load(&format!(
        "<actor name='a'><skin/></actor><actor name='b'/><model name='m'>{}</model>",
        boxed("", BOX)
    ));
    assert_eq!(scene.actors.len(), 2);
    // A model file alone; an unknown extension; no file.
    world.model("crate", &boxed("0 0 3 0 0 0", BOX));
    let scene = load(
        &world.0.join("models/crate/model.sdf"),
        &LoadOptions::default(),
    )
    .unwrap();
    assert_eq!((scene.name.as_str(), scene.floor), ("model", 0.0));
    assert!(load(Path::new("x.fbx"), &LoadOptions::default())
        .unwrap_err()
        .to_string()
        .contains("'fbx'"));
    assert!(load(&world.0.join("none.sdf"), &LoadOptions::default()).is_err());
    assert!(load(&world.0.join("worlds"), &LoadOptions::default()).is_err());
}

#[test]
fn actors_walk() {
    let world = World::new("actors");
    let point = |t: f32, x: f32, y: f32| {
        format!("<waypoint><time>{t}</time><pose>{x} {y} 1 0 0 0</pose></waypoint>")
    };
    let script = |points: &[String]| {
        format!(
            "<script><loop>1</loop><trajectory id='0' type='walking'>{}</trajectory></script>",
            points.concat()
        )
    };
    let there = script(&[point(0.0, 1.0, 2.0), point(4.0, 3.0, 2.0)]);
    let square = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (0.0, 0.1)];
    let square = square.iter().enumerate();
    let round: Vec<String> = square.map(|(i, (x, y))| point(i as f32, *x, *y)).collect();
    let scene = world.load(&format!(
        "<actor name='a'><pose>9 9 1 0 0 0</pose>{there}</actor>
        <actor name='b'>{}</actor>
        <actor name='c'><pose>0 1 1.25 0 0 0</pose><plugin><target>0 -5 1.2</target></plugin></actor>
        <actor name='d'><pose>4 5 1 0 0 0</pose></actor>
        <actor name='e'><plugin><target>here</target></plugin></actor>
        <actor name='f'><script><trajectory><waypoint><time>x</time></waypoint></trajectory></script></actor>
        <actor name='g'><pose>1e300 0 0 0 0 0</pose></actor>
        <model name='m'>{}</model>",
        script(&round),
        boxed("", BOX)
    ));
    let paths: Vec<Vec<[f32; 2]>> = scene
        .actors
        .iter()
        .map(|a| a.path.iter().map(|p| p.to_array()).collect())
        .collect();
    assert_eq!(
        paths,
        [
            vec![[1.0, 2.0], [3.0, 2.0]],
            vec![[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]],
            vec![[0.0, 1.0], [0.0, -5.0]],
            vec![[4.0, 5.0]],
        ]
    );
    let [a, b, c, d] = &scene.actors[..] else {
        panic!()
    };
    assert!(!a.round && b.round && !c.round && d.period() == 0.0);
    assert!((a.speed - 0.5).abs() < 1e-6 && (b.speed - 7.9 / 4.0).abs() < 1e-5);
    let warnings = scene.report.warnings.join(" ");
    for what in ["'here'", "'x'", "name='g'"] {
        assert!(warnings.contains(what), "{what}: {warnings}");
    }
}

/// The cafe's two actors have a pose and a plugin's target.
#[test]
fn the_cafe_has_two_guests() {
    let folder = std::env::var("NBV_GYM_SCENES").unwrap_or_else(|_| "../shared/scenes".into());
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join(folder)
        .join("cafe/worlds/cafe.world");
    if !path.exists() {
        eprintln!("skipped: no scene at {}", path.display());
        return;
    }
    let scene = load(&path, &LoadOptions::default()).unwrap();
    let paths: Vec<_> = scene.actors.iter().map(|a| a.path.clone()).collect();
    let at = |x: f32, y: f32| crate::geometry::Vec2::new(x, y);
    assert_eq!(
        paths,
        [
            vec![at(0.0, 1.0), at(0.0, -5.0)],
            vec![at(-2.0, -2.0), at(3.0, 2.0)]
        ]
    );
}
