//! Snapshots of a simulator; what could be loaded goes on.
use nbv_core::arm::Arm;
use nbv_core::belief::gain::{Gain, RaySpacing};
use nbv_core::belief::octree::SensorModel;
use nbv_core::belief::viewpoints::ViewSpace;
use nbv_core::camera::Camera;
use nbv_core::metrics::METRICS;
use nbv_core::robot::Robot;
use nbv_core::setup::{LocalMap, MapSpec, SceneChoice, Setup, Truth};
use nbv_core::simulator::{Buffers, Simulator};
use nbv_core::snapshot::{sealed, unsealed};
use nbv_core::world::bodies::BodiesSpec;
use nbv_core::world::lidar::Lidar;
use nbv_core::world::noise::DepthNoise;
use nbv_core::Error;

/// A free camera among people and boxes, whose sensors are noisy; a dome whose map keeps from where it was seen; an arm with
/// somebody near. Small maps and images, so that a snapshot has few bytes.
fn setups() -> [Setup; 3] {
    let flying = || Robot::flying(0.1, 0.5, 1.5).expect("a robot");
    let setup = |views: ViewSpace, robot: Robot| Setup {
        scene: SceneChoice::parse("room:0").expect("a scene"),
        camera: Camera::from_fov(6, 4, 1.05, 0.8, 0.0, 2.0).expect("a camera"),
        robot,
        map: MapSpec::new(0.4, 2.0, SensorModel::default()).expect("a map"),
        views,
        local_map: Some(LocalMap::new(4, 0.4).expect("a window")),
        noise: None,
        lidar: None,
        bodies: BodiesSpec::default(),
        truth: Truth::default(),
    };
    let dome = || ViewSpace::dome(2, 6, 0.5, -0.5, 0.9).expect("a dome");
    let mut free = setup(ViewSpace::six_directions(0.3).expect("steps"), flying());
    free.noise = Some(DepthNoise::preset("kinect_v1").expect("a camera's noise"));
    free.lidar = Some(Lidar::new(6, 0.0, 5.0, -0.3, 0.01).expect("a lidar"));
    free.bodies.drawn_walkers = 1;
    free.bodies.drawn_boxes = 2;
    let mut seen = setup(dome(), flying());
    seen.map.view_history = true;
    let links = Arm::new(0.425, 0.392, 0.06).expect("an arm");
    let mut arm = setup(dome(), flying().held_by(links));
    arm.bodies.drawn_walkers = 1;
    [free, seen, arm]
}

/// Load what the first byte says the setup of, look at everything, go on, save, load again.
pub fn snapshot(data: &[u8]) {
    let Some((which, rest)) = data.split_first() else {
        return;
    };
    let setups = setups();
    let setup = &setups[usize::from(*which) % setups.len()];
    let bytes = sealed(setup, rest).expect("a setup");
    let mut simulator = Simulator::new(setup.clone(), 1, 1).expect("a simulator");
    let mut shown = Shown::of(&simulator);
    if sound(simulator.load(&bytes, shown.buffers())).is_none()
        || sound(simulator.episode(0)).is_none()
    {
        return;
    }
    let saved = simulator.save(b"").expect("a snapshot");
    let mut again = Simulator::new(setup.clone(), 1, 1).expect("a simulator");
    again
        .load(&saved, Buffers::default())
        .expect("what we write can be read");
    assert!(again.save(b"").expect("a snapshot") == saved);
    sound(simulator.changed(0));
    for number in 0..2 {
        let Some(episode) = sound(simulator.episode(0)) else {
            return;
        };
        let candidates = episode.belief().candidates().to_vec();
        let goal = candidates[number * 3 % candidates.len()];
        sound(simulator.view_gain(0, &candidates, Gain::Entropy, RaySpacing::Stride(2)));
        sound(simulator.foresee(0, &[goal]));
        sound(simulator.step(&[goal.to_array()], &[false], shown.buffers()));
    }
    let saved = simulator.save(b"").expect("a snapshot");
    again
        .load(&saved, Buffers::default())
        .expect("what we write can be read");
    sound(simulator.reset(&[true], &[None], shown.buffers()));
}

/// Whether a snapshot's bytes can be loaded.
pub fn is_loaded(data: &[u8]) -> bool {
    let setup = setups().into_iter().nth(usize::from(data[0]));
    let setup = setup.expect("one of the setups");
    let bytes = sealed(&setup, &data[1..]).expect("a setup");
    let mut simulator = Simulator::new(setup, 1, 1).expect("a simulator");
    simulator.load(&bytes, Buffers::default()).is_ok() && simulator.episode(0).is_ok()
}

/// Errors are answers, but for those that speak of a fault of our own.
fn sound<T>(outcome: Result<T, Error>) -> Option<T> {
    match outcome {
        Ok(value) => Some(value),
        Err(error) => {
            assert!(!matches!(error, Error::Internal(_)), "{error}");
            None
        }
    }
}

/// One of each setup, after a few steps.
pub fn made() -> Vec<Vec<u8>> {
    let setups = setups().into_iter().enumerate();
    let made = setups.map(|(which, setup)| {
        let mut simulator = Simulator::new(setup, 1, 1).expect("a simulator");
        simulator
            .reset(&[true], &[Some(1)], Buffers::default())
            .expect("an episode");
        for number in 0..2 {
            let candidates = simulator.episode(0).expect("an episode").belief();
            let goal = candidates.candidates()[number + 1].to_array();
            simulator
                .step(&[goal], &[false], Buffers::default())
                .expect("a step");
            // Notes of changes go into the snapshot, too.
            simulator.changed(0).expect("changes");
        }
        let bytes = simulator.save(b"n").expect("a snapshot");
        let rest = unsealed(&bytes).expect("a setup");
        [&[which as u8], rest].concat()
    });
    made.collect()
}

/// All that a simulator of one environment shows.
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
    fn of(simulator: &Simulator) -> Self {
        let (setup, k) = (simulator.setup(), simulator.num_candidates());
        Self {
            depth: vec![0.0; setup.camera.pixels()],
            scan: vec![0.0; setup.lidar.as_ref().map_or(0, |l| l.rays)],
            pose: vec![0.0; 7],
            local_map: vec![0.0; 3 * setup.local_map.map_or(0, |m| m.cells())],
            visited: vec![0.0; k],
            candidates: vec![0.0; 7 * k],
            mask: vec![false; k],
            metrics: vec![0.0; METRICS.len()],
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
