//! Steps of one environment like `NBV/DomeRoom-v0` (64 x 48 depth, 10 cm voxels, 4 m), and of 64 in one thread.
use criterion::{criterion_group, criterion_main, Criterion, Throughput};
use nbv_core::belief::octree::SensorModel;
use nbv_core::belief::viewpoints::ViewSpace;
use nbv_core::camera::Camera;
use nbv_core::error::Result;
use nbv_core::metrics::METRICS;
use nbv_core::robot::Robot;
use nbv_core::setup::{MapSpec, SceneChoice, Setup, Truth};
use nbv_core::simulator::{Buffers, Simulator};
use nbv_core::world::bodies::BodiesSpec;

const BUDGET: usize = 30;

/// Environments that are stepped from view to view of the dome and begin anew after `BUDGET` steps.
struct Bench {
    simulator: Simulator,
    candidates: Vec<[f32; 7]>,
    depth: Vec<f32>,
    mask: Vec<bool>,
    metrics: Vec<f64>,
    turn: usize,
}

impl Bench {
    fn new(envs: usize) -> Result<Self> {
        let camera = Camera::from_fov(64, 48, 1.05, 0.817, 0.05, 4.0)?;
        let pixels = camera.pixels();
        let setup = Setup {
            scene: SceneChoice::parse("room:6")?,
            camera,
            robot: Robot::flying(0.1, 1.0, 1.0)?,
            map: MapSpec::new(0.1, 4.0, SensorModel::default())?,
            views: ViewSpace::dome(14, 48, 0.6, -0.6, 1.0)?,
            local_map: None,
            noise: None,
            lidar: None,
            bodies: BodiesSpec::default(),
            truth: Truth::default(),
        };
        let views = setup.views.count();
        let mut simulator = Simulator::new(setup, envs, 1)?;
        let seeds: Vec<_> = (0..envs as u64).map(Some).collect();
        simulator.reset(&vec![true; envs], &seeds, Buffers::default())?;
        let belief = simulator.episode(0)?.belief();
        let candidates = belief.candidates().iter().map(|c| c.to_array()).collect();
        Ok(Self {
            simulator,
            candidates,
            depth: vec![0.0; envs * pixels],
            mask: vec![false; envs * views],
            metrics: vec![0.0; envs * METRICS.len()],
            turn: 0,
        })
    }

    fn step(&mut self) -> Result<()> {
        let (envs, count) = (self.simulator.num_envs(), self.candidates.len());
        self.turn += 1;
        // A stride that visits the whole dome, and another place in it for every environment.
        let commands: Vec<_> = (0..envs)
            .map(|i| self.candidates[(self.turn * 263 + i * 97) % count])
            .collect();
        let fresh = vec![self.turn.is_multiple_of(BUDGET); envs];
        let buffers = Buffers {
            depth: Some(&mut self.depth),
            mask: Some(&mut self.mask),
            metrics: Some(&mut self.metrics),
            ..Buffers::default()
        };
        self.simulator.step(&commands, &fresh, buffers)
    }
}

fn steps(c: &mut Criterion) {
    for envs in [1, 64] {
        let mut bench = Bench::new(envs).expect("a valid setup");
        let mut group = c.benchmark_group("step/dome_room");
        group.sample_size(20);
        group.throughput(Throughput::Elements(envs as u64));
        group.bench_function(format!("{envs} environments"), |b| {
            b.iter(|| bench.step().expect("viewpoints of the dome"))
        });
        group.finish();
    }
}

criterion_group!(benches, steps);
criterion_main!(benches);
