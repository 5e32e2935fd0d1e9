use crate::arm::Arm;
use crate::belief::octree::SensorModel;
use crate::belief::viewpoints::ViewSpace;
use crate::camera::Camera;
use crate::episode::EpisodeState;
use crate::metrics::METRICS;
use crate::robot::Robot;
use crate::setup::{LocalMap, MapSpec, SceneChoice, Setup, Truth};
use crate::simulator::{Buffers, Simulator};
use crate::world::bodies::BodiesSpec;
use crate::world::lidar::Lidar;
use crate::world::noise::DepthNoise;
use crate::world::SceneSource;
use proptest::prelude::*;
use std::sync::OnceLock;

fn setup(scene: &str, views: ViewSpace) -> Setup {
    Setup {
        scene: SceneChoice::parse(scene).unwrap(),
        camera: Camera::from_fov(32, 24, 1.05, 0.8, 0.0, 4.0).unwrap(),
        robot: Robot::flying(0.1, 0.5, 1.5).unwrap(),
        map: MapSpec::new(0.1, 4.0, SensorModel::default()).unwrap(),
        views,
        local_map: Some(LocalMap::new(8, 0.2).unwrap()),
        noise: None,
        lidar: None,
        bodies: BodiesSpec::default(),
        truth: Truth::default(),
    }
}

/// People, boxes, noise in depth and scan.
fn lively() -> Setup {
    Setup {
        noise: Some(DepthNoise::preset("kinect_v1").unwrap()),
        lidar: Some(Lidar::new(36, 0.0, 5.0, -0.3, 0.01).unwrap()),
        bodies: BodiesSpec {
            drawn_walkers: 2,
            drawn_boxes: 2,
            ..BodiesSpec::default()
        },
        ..six()
    }
}

fn dome() -> Setup {
    setup("room:0-3", ViewSpace::dome(4, 8, 0.5, -0.5, 0.9).unwrap())
}

/// An arm among people.
fn arm() -> Setup {
    let links = Arm::new(0.425, 0.392, 0.06).unwrap();
    Setup {
        robot: Robot::flying(0.1, 0.5, 1.5).unwrap().held_by(links),
        bodies: BodiesSpec {
            drawn_walkers: 1,
            ..BodiesSpec::default()
        },
        ..dome()
    }
}

fn six() -> Setup {
    setup("room:0-3", ViewSpace::six_directions(0.3).unwrap())
}

/// Everything that a simulator shows, bit by bit.
#[derive(Default, PartialEq)]
struct Shown {
    depth: Vec<f32>,
    scan: Vec<f32>,
    pose: Vec<f32>,
    local_map: Vec<f32>,
    visited: Vec<f32>,
    candidates: Vec<f32>,
    mask: Vec<bool>,
    metrics: Vec<f64>,
}

impl Shown {
    fn new(simulator: &Simulator) -> Self {
        let (n, k) = (simulator.num_envs(), simulator.num_candidates());
        let setup = simulator.setup();
        Self {
            depth: vec![0.0; n * setup.camera.pixels()],
            scan: vec![0.0; n * setup.lidar.as_ref().map_or(0, |l| l.rays)],
            pose: vec![0.0; n * 7],
            local_map: vec![0.0; n * 3 * setup.local_map.unwrap().cells()],
            visited: vec![0.0; n * k],
            candidates: vec![0.0; n * k * 7],
            mask: vec![false; n * k],
            metrics: vec![0.0; n * METRICS.len()],
        }
    }

    fn buffers(&mut self) -> Buffers<'_> {
        Buffers {
            depth: Some(&mut self.depth),
            scan: (!self.scan.is_empty()).then_some(&mut self.scan),
            pose: Some(&mut self.pose),
            local_map: Some(&mut self.local_map),
            visited: Some(&mut self.visited),
            candidates: Some(&mut self.candidates),
            mask: Some(&mut self.mask),
            metrics: Some(&mut self.metrics),
        }
    }
}

/// Step every environment to a candidate that depends on the step alone; some begin anew.
fn step(simulator: &mut Simulator, number: usize) -> Shown {
    let n = simulator.num_envs();
    let mut shown = Shown::new(simulator);
    let commands: Vec<[f32; 7]> = (0..n)
        .map(|i| {
            let candidates = simulator.episode(i).unwrap().belief().candidates();
            candidates[(number * 5 + i) % candidates.len()].to_array()
        })
        .collect();
    let reset: Vec<bool> = (0..n).map(|i| i == 1 && number % 4 == 3).collect();
    simulator.step(&commands, &reset, shown.buffers()).unwrap();
    shown
}

#[test]
fn a_loaded_simulator_goes_on_bit_for_bit() {
    for make in [dome, six, lively, arm] {
        let mut original = Simulator::new(make(), 3, 1).unwrap();
        original
            .reset(&[true; 3], &[Some(1), Some(2), Some(3)], Buffers::default())
            .unwrap();
        let mut shown = Shown::new(&original);
        for number in 0..6 {
            shown = step(&mut original, number);
            if number == 2 {
                original.changed(0).unwrap();
            }
        }
        let bytes = original.save(b"mine").unwrap();
        assert_eq!(&*super::read(&bytes).unwrap().notes, b"mine");
        let mut copy = Simulator::new(make(), 3, 2).unwrap();
        let mut filled = Shown::new(&copy);
        copy.load(&bytes, filled.buffers()).unwrap();
        assert!(filled == shown, "the buffers are what they were");
        assert!(
            copy.save(b"mine").unwrap() == bytes,
            "saved again it is the same"
        );
        for number in 6..16 {
            assert!(
                step(&mut original, number) == step(&mut copy, number),
                "step {number}"
            );
        }
        assert_eq!(original.changed(0).unwrap(), copy.changed(0).unwrap());
        assert!(copy.save(b"").unwrap() == original.save(b"").unwrap());
    }
}

fn remembering() -> Setup {
    let mut setup = dome();
    setup.map.view_history = true;
    setup
}

/// Episodes take over the memory of those before them, of this scene and of others.
#[test]
fn an_episode_knows_nothing_of_those_before() {
    for make in [dome, six, lively, arm, remembering] {
        let mut fresh = Simulator::new(make(), 3, 1).unwrap();
        let mut used = Simulator::new(make(), 3, 1).unwrap();
        for (begin, steps) in [(10, 7), (20, 3)] {
            let seeds = [Some(begin), Some(begin + 1), Some(begin + 2)];
            used.reset(&[true; 3], &seeds, Buffers::default()).unwrap();
            for number in 0..steps {
                step(&mut used, number);
                used.changed(1).unwrap();
            }
        }
        for simulator in [&mut fresh, &mut used] {
            let seeds = [Some(1), Some(2), Some(3)];
            simulator
                .reset(&[true; 3], &seeds, Buffers::default())
                .unwrap();
        }
        for number in 0..4 {
            assert!(
                used.save(b"").unwrap() == fresh.save(b"").unwrap(),
                "step {number}"
            );
            let (one, other) = (step(&mut used, number), step(&mut fresh, number));
            assert!(one == other, "step {number}");
        }
        assert_eq!(used.changed(0).unwrap(), fresh.changed(0).unwrap());
    }
}

#[test]
fn what_was_never_begun_stays_so() {
    let mut original = Simulator::new(six(), 2, 1).unwrap();
    original
        .reset(&[false, true], &[None, Some(9)], Buffers::default())
        .unwrap();
    let mut copy = Simulator::new(six(), 2, 1).unwrap();
    copy.load(&original.save(b"").unwrap(), Buffers::default())
        .unwrap();
    assert!(copy.episode(0).is_err() && copy.episode(1).is_ok());
    for simulator in [&mut original, &mut copy] {
        simulator
            .reset(&[true; 2], &[None; 2], Buffers::default())
            .unwrap();
    }
    assert!(copy.save(b"").unwrap() == original.save(b"").unwrap());
}

/// A small snapshot, and the simulator that it can be loaded into.
fn saved() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| {
        let mut simulator = Simulator::new(six(), 1, 1).unwrap();
        simulator
            .reset(&[true], &[Some(5)], Buffers::default())
            .unwrap();
        simulator.changed(0).unwrap();
        step(&mut simulator, 0);
        simulator.save(b"notes").unwrap()
    })
}

#[test]
fn what_does_not_fit_is_named_and_changes_nothing() {
    let mut simulator = Simulator::new(dome(), 1, 1).unwrap();
    simulator
        .reset(&[true], &[Some(4)], Buffers::default())
        .unwrap();
    let before = simulator.save(b"").unwrap();
    let mut error = |bytes: &[u8]| {
        let error = simulator.load(bytes, Buffers::default());
        error.unwrap_err().to_string()
    };
    assert!(
        error(saved()).contains("another setup: views: SixDirections"),
        "{}",
        error(saved())
    );
    let two = Simulator::new(dome(), 2, 1).unwrap().save(b"").unwrap();
    assert!(error(&two).contains("2 rows for 1"), "{}", error(&two));
    let mut bytes = before.clone();
    bytes[8] = 77;
    assert!(error(&bytes).contains("version 77 is newer"));
    bytes[8] = 0;
    assert!(error(&bytes).contains("version 0 is older"));
    bytes[0] = 0;
    assert!(error(&bytes).contains("do not begin"));
    assert!(error(&before[..100]).contains("damaged"));
    assert!(error(&[]).contains("too early"));
    assert!(simulator.save(b"").unwrap() == before);
}

/// Whether a snapshot can be loaded once its only episode was changed.
fn forged(change: impl FnOnce(&mut EpisodeState)) -> String {
    let mut simulator = Simulator::new(lively(), 1, 1).unwrap();
    simulator
        .reset(&[true], &[Some(5)], Buffers::default())
        .unwrap();
    step(&mut simulator, 0);
    let bytes = simulator.save(b"").unwrap();
    let mut snapshot = super::read(&bytes).unwrap();
    change(snapshot.slots[0].episode.as_mut().unwrap());
    let forged = super::write(&lively(), b"", snapshot.slots).unwrap();
    match simulator.load(&forged, Buffers::default()) {
        Ok(()) => String::new(),
        Err(error) => error.to_string(),
    }
}

/// A later motion would go through all the ticks that are missing, or count them beyond u64.
#[test]
fn a_clock_that_ran_without_the_bodies_is_an_error() {
    assert_eq!(forged(|_| ()), "");
    for time in [1e300, 3600.0] {
        let error = forged(|episode| episode.world.time = time);
        assert!(error.contains("do not fit a clock"), "{error}");
    }
}

/// Nobody is made to open a file or to generate a scene that the task does not know.
#[test]
fn another_scene_is_an_error() {
    for source in [
        SceneSource::File("/dev/zero".into()),
        SceneSource::Generated {
            kind: "room".into(),
            seed: 4,
        },
        SceneSource::Generated {
            kind: "shop".into(),
            seed: 0,
        },
    ] {
        let error = forged(|episode| episode.source = source);
        assert!(error.contains("takes place in"), "{error}");
    }
}

#[test]
fn a_file_may_have_moved_as_far_as_its_own_path_does_not_say() {
    let at = |path: &str| SceneSource::File(path.into());
    let choice = |path: &str| SceneChoice::File(path.into());
    for path in ["a.obj", "./a.obj", "there/a.obj", "/home/there/a.obj"] {
        assert!(choice(path).has(&at("/home/there/a.obj")), "{path}");
    }
    for path in [
        "b.obj",
        "other/a.obj",
        "/there/a.obj",
        "/x/home/there/a.obj",
    ] {
        assert!(!choice(path).has(&at("/home/there/a.obj")), "{path}");
    }
    assert!(choice("../a.obj").has(&at("/home/there/../a.obj")));
}

#[test]
fn a_changed_scene_file_is_an_error() {
    let folder = std::env::temp_dir().join(format!("nbv-snapshot-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("boxes.obj");
    // A room of 6 x 5 x 3 metres, open to look into, with a wall in it that moves.
    let room = |x: f32| {
        let corners: String = [(0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (0.0, 5.0)]
            .iter()
            .flat_map(|(x, y)| [0.0, 3.0].map(|z| format!("v {x} {y} {z}\n")))
            .collect();
        let wall: String = [(0.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
            .iter()
            .map(|(y, z)| format!("v {x} {y} {z}\n"))
            .collect();
        let faces = "f 1 3 5 7\nf 2 4 6 8\nf 1 3 4 2\nf 3 5 6 4\nf 5 7 8 6\nf 7 1 2 8\nf 9 10 11\n";
        format!("{corners}{wall}{faces}")
    };
    std::fs::write(&path, room(4.0)).unwrap();
    let make = || {
        setup(
            path.to_str().unwrap(),
            ViewSpace::six_directions(0.3).unwrap(),
        )
    };
    let mut simulator = Simulator::new(make(), 1, 1).unwrap();
    simulator
        .reset(&[true], &[Some(1)], Buffers::default())
        .unwrap();
    let bytes = simulator.save(b"").unwrap();
    let mut copy = Simulator::new(make(), 1, 1).unwrap();
    copy.load(&bytes, Buffers::default()).unwrap();
    assert!(step(&mut copy, 0) == step(&mut simulator, 0));
    std::fs::write(&path, room(4.25) + "# other\n").unwrap();
    let error = copy
        .load(&bytes, Buffers::default())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("boxes.obj") && error.contains("content changed"),
        "{error}"
    );
    std::fs::remove_file(&path).unwrap();
    let error = copy
        .load(&bytes, Buffers::default())
        .unwrap_err()
        .to_string();
    assert!(error.contains("boxes.obj"), "{error}");
    std::fs::remove_dir(&folder).unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]
    #[test]
    fn damage_is_found_and_forgery_is_survived(at in any::<prop::sample::Index>(), flip in 1u8..=255, cut in any::<prop::sample::Index>()) {
        let mut bytes = saved().to_vec();
        // The header of the content is where most structure is: half of the cases go there.
        let reach = if flip % 2 == 0 { bytes.len() } else { super::HEADER + 1200 };
        let at = at.index(reach);
        bytes[at] ^= flip;
        let mut simulator = Simulator::new(six(), 1, 1).unwrap();
        prop_assert!(simulator.load(&bytes, Buffers::default()).is_err());
        let mend = |bytes: &mut Vec<u8>| {
            let sum = xxhash_rust::xxh3::xxh3_64(&bytes[super::HEADER..]).to_le_bytes();
            bytes[12..20].copy_from_slice(&sum);
        };
        // With a right checksum it may be a good snapshot of something else. Whatever it is: no panic.
        mend(&mut bytes);
        if simulator.load(&bytes, Buffers::default()).is_ok() {
            step(&mut simulator, 1);
        }
        bytes.truncate(super::HEADER + cut.index(bytes.len() - super::HEADER));
        mend(&mut bytes);
        prop_assert!(simulator.load(&bytes, Buffers::default()).is_err());
    }
}
