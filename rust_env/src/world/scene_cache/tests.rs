//! A cache gives what was put in, notices every change, survives damage, crowds and rivals.
use super::*;
use crate::camera::Camera;
use crate::geometry::{Pose, Vec3};
use crate::world::scenes::LoadOptions;
use crate::world::test_scenes::room;
use crate::world::SceneAssets;
use proptest::prelude::*;
use std::sync::Arc;

/// A folder of its own with a world of two files and a cache, removed at the end.
struct Place(PathBuf);

impl Place {
    fn new(name: &str) -> Self {
        let folder = env::temp_dir().join(format!("nbv-cache-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(folder.join("models/room/meshes")).unwrap();
        fs::create_dir_all(folder.join("worlds")).unwrap();
        let place = Self(folder);
        place.file("models/room/model.sdf", "<sdf version='1.6'><model name='room'><link name='l'><visual name='v'>
            <geometry><mesh><uri>model://room/meshes/room.obj</uri></mesh></geometry></visual></link></model></sdf>");
        place.file(
            "worlds/a.world",
            "<sdf version='1.6'><world name='w'><include><uri>model://room</uri></include>
            <include><uri>model://later</uri></include></world></sdf>",
        );
        place.mesh(0.0);
        place
    }

    fn file(&self, name: &str, text: &str) {
        let path = self.0.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    /// The room, lifted by a few millimetres: as many bytes as before.
    fn mesh(&self, lift: f32) {
        let mesh = room(0.4);
        let mut text = String::new();
        for v in &mesh.vertices {
            text += &format!("v {:+.4} {:+.4} {:+.4}\n", v.x, v.y, v.z + lift);
        }
        for t in &mesh.triangles {
            text += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1);
        }
        self.file("models/room/meshes/room.obj", &text);
    }

    fn cache(&self) -> SceneCache {
        SceneCache::new(self.0.join("cache"), MAX_BYTES)
    }

    fn load(&self) -> Arc<SceneAssets> {
        self.load_with(&LoadOptions::default(), self.cache())
    }

    fn load_with(&self, options: &LoadOptions, cache: SceneCache) -> Arc<SceneAssets> {
        SceneAssets::read(&self.0.join("worlds/a.world"), options, Some(cache)).unwrap()
    }

    fn entry(&self) -> PathBuf {
        let entries = self.cache().files(EXTENSION);
        assert_eq!(entries.len(), 1);
        entries[0].path.clone()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn image(assets: &SceneAssets) -> Vec<f32> {
    let camera = Camera::from_fov(64, 48, 1.5, 1.2, 0.05, 20.0).unwrap();
    let mut image = vec![0.0; camera.pixels()];
    let view = Pose::from_yaw_pitch(Vec3::new(2.0, 2.0, 1.2), 0.4, -0.2);
    assets.renderer.render(&camera, &view, &mut image);
    image
}

fn assert_same(a: &SceneAssets, b: &SceneAssets) {
    assert_eq!(a.scene.visual, b.scene.visual);
    assert_eq!(a.scene.objects, b.scene.objects);
    assert_eq!(a.scene.collision, b.scene.collision);
    assert_eq!(a.scene.bounds, b.scene.bounds);
    assert_eq!(
        (a.scene.floor, a.scene.ground_plane),
        (b.scene.floor, b.scene.ground_plane)
    );
    assert_eq!((&a.scene.name, &a.starts), (&b.scene.name, &b.starts));
    let (mut left, mut right) = (a.scene.report.clone(), b.scene.report.clone());
    for report in [&mut left, &mut right] {
        (report.load_milliseconds, report.cache) = (0.0, String::new());
    }
    assert_eq!(format!("{left:?}"), format!("{right:?}"));
    assert_eq!(image(a), image(b));
}

#[test]
fn the_second_load_is_the_first() {
    let place = Place::new("same");
    let (first, second) = (place.load(), place.load());
    assert_eq!(first.scene.report.cache, "new");
    assert_eq!(second.scene.report.cache, "read");
    assert_eq!(second.scene.report.missing, ["model://later"]);
    assert!(!second.starts.is_empty() && image(&second).iter().any(|d| d.is_finite()));
    assert_same(&first, &second);
    // Without a cache the same again.
    let path = place.0.join("worlds/a.world");
    let bare = SceneAssets::read(&path, &LoadOptions::default(), None).unwrap();
    assert_same(&first, &bare);
    // Another way to read is another entry.
    let honour = LoadOptions {
        honour_up_axis: true,
        ..LoadOptions::default()
    };
    assert_eq!(
        place.load_with(&honour, place.cache()).scene.report.cache,
        "new"
    );
    assert_eq!(place.cache().size().0, 2);
    assert_eq!(place.cache().clear().unwrap(), 2);
    assert_eq!(place.cache().size(), (0, 0));
    assert_eq!(place.load().scene.report.cache, "new");
}

#[test]
fn every_change_is_noticed() {
    let place = Place::new("change");
    let first = place.load();
    let mesh = place.0.join("models/room/meshes/room.obj");
    let old = fs::metadata(&mesh).unwrap();
    // Other bytes of the same number and the same time.
    place.mesh(0.004);
    let file = File::options().append(true).open(&mesh).unwrap();
    file.set_times(FileTimes::new().set_modified(old.modified().unwrap()))
        .unwrap();
    assert_eq!(fs::metadata(&mesh).unwrap().len(), old.len());
    let second = place.load();
    assert_eq!(second.scene.report.cache, "made anew: a file has changed");
    assert_ne!(first.scene.visual, second.scene.visual);
    // A model that was missing and is there now.
    place.file(
        "models/later/model.sdf",
        "<sdf version='1.6'><model name='n'><link name='l'><visual name='v'><geometry><box>
        <size>1 1 1</size></box></geometry></visual></link></model></sdf>",
    );
    let third = place.load();
    assert_eq!(third.scene.report.cache, "made anew: a file has changed");
    assert_eq!(
        third.scene.visual.triangles.len(),
        second.scene.visual.triangles.len() + 12
    );
    // Another folder that is searched.
    assert_eq!(place.load().scene.report.cache, "read");
    place.file("worlds/models/room/model.sdf", "<sdf/>");
    assert_ne!(place.load().scene.report.cache, "read");
}

#[test]
fn damaged_and_older_entries_are_made_anew() {
    let place = Place::new("damage");
    let first = place.load();
    let whole = fs::read(place.entry()).unwrap();
    let version = MAGIC.len() + 8;
    for (at, note) in [
        (0, "not an entry"),
        (version, "another version"),
        (whole.len() / 2, "damaged"),
        (whole.len() - 1, "damaged"),
    ] {
        let mut bytes = whole.clone();
        bytes[at] ^= 1;
        fs::write(place.entry(), &bytes).unwrap();
        let again = place.load();
        assert!(
            again.scene.report.cache.contains(note),
            "{at}: {}",
            again.scene.report.cache
        );
        assert_same(&first, &again);
        assert_eq!(place.load().scene.report.cache, "read");
    }
    for length in [0, 5, version + 3, whole.len() - 1] {
        fs::write(place.entry(), &whole[..length]).unwrap();
        assert!(
            place.load().scene.report.cache.starts_with("made anew"),
            "{length}"
        );
    }
    // A folder in the entry's place can be neither read nor replaced.
    let entry = place.entry();
    fs::remove_file(&entry).unwrap();
    fs::create_dir(&entry).unwrap();
    let report = &place.load().scene.report;
    assert!(report.cache.ends_with("not kept"), "{}", report.cache);
    assert!(
        report.warnings.iter().any(|w| w.contains("not cached")),
        "{:?}",
        report.warnings
    );
}

#[test]
fn a_cache_that_cannot_be_written_only_costs_time() {
    let place = Place::new("full");
    let first = place.load();
    place.file("file", "");
    let caches = [
        SceneCache::new(place.0.join("file/cache"), MAX_BYTES),
        // Full: the entry is larger than all that may be kept.
        SceneCache::new(place.0.join("small"), 1000),
    ];
    for cache in caches {
        let again = place.load_with(&LoadOptions::default(), cache.clone());
        let report = &again.scene.report;
        assert_eq!(report.cache, "new, not kept");
        assert!(
            report.warnings.iter().any(|w| w.contains("not cached")),
            "{:?}",
            report.warnings
        );
        assert_eq!(again.scene.visual, first.scene.visual);
        assert_eq!(cache.size(), (0, 0));
    }
}

#[test]
fn the_oldest_entries_go() {
    let place = Place::new("oldest");
    let cache = SceneCache::new(place.0.join("small"), 4000);
    let age = |question: u128, seconds: u64| {
        let file = File::options()
            .append(true)
            .open(cache.path(question))
            .unwrap();
        let then = SystemTime::now() - Duration::from_secs(seconds);
        file.set_times(FileTimes::new().set_modified(then)).unwrap();
    };
    for question in 0..3 {
        cache.write(question, &[1; 1000]).unwrap();
        age(question, 100 - question as u64);
    }
    place.file("small/notes.nbv", "not ours");
    // Used: now the youngest.
    assert!(matches!(cache.read(0), Found::Good(bytes) if bytes == [1; 1000]));
    cache.write(3, &[1; 1000]).unwrap();
    let there: Vec<bool> = (0..4).map(|q| cache.path(q).exists()).collect();
    assert_eq!(there, [true, false, true, true]);
    assert!(cache.size().1 <= 4000);
    assert!(matches!(cache.read(1), Found::Nothing));
    cache.clear().unwrap();
    assert!(place.0.join("small/notes.nbv").exists());
}

#[test]
fn rivals_do_no_harm() {
    let place = Place::new("rivals");
    let cache = place.cache();
    let payload = |k: u8| vec![k; 200_000];
    std::thread::scope(|scope| {
        for k in 0..4 {
            let cache = &cache;
            scope.spawn(move || {
                for _ in 0..20 {
                    cache.write(7, &payload(k)).unwrap();
                    match cache.read(7) {
                        Found::Good(bytes) => assert!((0..4).any(|k| bytes == payload(k))),
                        other => panic!("{other:?}"),
                    }
                }
            });
        }
    });
    assert_eq!((cache.size().0, cache.files("draft").len()), (1, 0));
}

#[test]
fn ground_truth_is_kept() {
    let place = Place::new("truth");
    let make = |assets: &SceneAssets| {
        let bounds = assets.scene.bounds;
        let camera = Camera::from_fov(64, 48, 1.5, 1.2, 0.05, 20.0).unwrap();
        let eyes = [Vec3::new(2.0, 2.0, 1.2)];
        let sight = crate::world::ground_truth::Sight::Positions(&eyes);
        crate::world::ground_truth::GroundTruth::new(
            &assets.scene.visual,
            &assets.renderer,
            &bounds,
            0.2,
            5.0,
            &camera,
            &sight,
        )
    };
    let (first, second) = (place.load(), place.load());
    let made = first.ground_truth("task".into(), || make(&first)).unwrap();
    let kept = second
        .ground_truth("task".into(), || panic!("not kept"))
        .unwrap();
    assert!(made.count() > 100);
    assert_eq!((kept.count(), kept.keys()), (made.count(), made.keys()));
    // Another task, and the same task in a scene that has changed.
    let other = second
        .ground_truth("other".into(), || make(&second))
        .unwrap();
    assert_eq!(other.keys(), made.keys());
    place.mesh(0.004);
    let changed = place.load();
    let mut asked = false;
    changed
        .ground_truth("task".into(), || {
            asked = true;
            make(&changed)
        })
        .unwrap();
    assert!(asked);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// Behind a checksum that is right, any byte may be wrong: a fault or another scene, which can be looked at.
    #[test]
    fn no_bytes_make_the_reader_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in prop::option::of(any::<prop::sample::Index>()),
        early in any::<bool>(),
    ) {
        thread_local! {
            static WHOLE: Vec<u8> = {
                let place = Place::new("fuzz");
                place.load();
                let bytes = fs::read(place.entry()).unwrap();
                let header = header_length(&bytes).unwrap();
                bytes[header..].to_vec()
            };
        }
        let mut bytes = WHOLE.with(Clone::clone);
        for (at, value) in edits {
            // Lengths and indices stand in the first part and in the nodes, which are few here.
            let at = at.index(if early { bytes.len() / 8 } else { bytes.len() });
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(entry) = read_scene(&bytes) {
            let camera = Camera::from_fov(16, 12, 1.5, 1.2, 0.05, 20.0).unwrap();
            let view = Pose::from_yaw_pitch(Vec3::new(2.0, 2.0, 1.2), 0.4, -0.2);
            for method in [crate::world::render::Method::Rays, crate::world::render::Method::Packets, crate::world::render::Method::Raster] {
                entry.renderer.render_by(method, &camera, &view, &mut vec![0.0; camera.pixels()]);
            }
        }
        let _ = read_truth(&bytes);
    }
}
