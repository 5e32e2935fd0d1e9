//! The spine: a simulator runs episodes, gains information, and does not depend on threads or company.
use nbv_core::belief::octree::SensorModel;
use nbv_core::belief::viewpoints::ViewSpace;
use nbv_core::camera::Camera;
use nbv_core::metrics::METRICS;
use nbv_core::robot::Robot;
use nbv_core::setup::{LocalMap, MapSpec, SceneChoice, Setup, Truth};
use nbv_core::simulator::{Buffers, Simulator};
use nbv_core::world::bodies::BodiesSpec;
use nbv_core::world::lidar::Lidar;
use nbv_core::world::noise::DepthNoise;

fn setup(views: ViewSpace) -> Setup {
    Setup {
        scene: SceneChoice::parse("room:0-3").unwrap(),
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

fn six() -> Setup {
    setup(ViewSpace::six_directions(0.3).unwrap())
}

/// People, boxes, noise in depth and scan.
fn lively() -> Setup {
    Setup {
        noise: Some(DepthNoise::preset("kinect_v1").unwrap()),
        lidar: Some(Lidar::new(36, 0.0, 5.0, -0.3, 0.01).unwrap()),
        bodies: BodiesSpec {
            drawn_walkers: 2,
            drawn_boxes: 1,
            ..BodiesSpec::default()
        },
        ..six()
    }
}

/// Everything that comes out of `n` environments over some steps, bit by bit.
struct Trace {
    rows: Vec<Vec<u64>>,
}

fn run(setup: Setup, seeds: &[u64], threads: usize, steps: usize) -> Trace {
    let n = seeds.len();
    let (pixels, k) = (setup.camera.pixels(), setup.views.count());
    let cells = setup.local_map.map_or(0, |w| w.cells());
    let rays = setup.lidar.as_ref().map_or(0, |l| l.rays);
    let mut simulator = Simulator::new(setup, n, threads).unwrap();
    let mut depth = vec![0f32; n * pixels];
    let mut scan = vec![0f32; n * rays];
    let mut pose = vec![0f32; n * 7];
    let mut local_map = vec![0f32; n * 3 * cells];
    let mut visited = vec![0f32; n * k];
    let mut candidates = vec![0f32; n * k * 7];
    let mut mask = vec![false; n * k];
    let mut metrics = vec![0f64; n * METRICS.len()];
    let mut trace = Trace {
        rows: vec![Vec::new(); n],
    };
    for step in 0..=steps {
        let out = Buffers {
            depth: Some(&mut depth),
            scan: (rays > 0).then_some(&mut scan[..]),
            pose: Some(&mut pose),
            local_map: Some(&mut local_map),
            visited: Some(&mut visited),
            candidates: Some(&mut candidates),
            mask: Some(&mut mask),
            metrics: Some(&mut metrics),
        };
        if step == 0 {
            let seeds: Vec<Option<u64>> = seeds.iter().map(|s| Some(*s)).collect();
            simulator.reset(&vec![true; n], &seeds, out).unwrap();
        } else {
            // Every environment takes its first admissible candidate after a rotating offset.
            let commands: Vec<[f32; 7]> = (0..n)
                .map(|i| {
                    let pick =
                        (0..k).map(|c| (c + step * 5) % k).find(|c| {
                            simulator.episode(i).unwrap().belief().is_admissible(
                                &simulator.episode(i).unwrap().belief().candidates()[*c],
                            )
                        });
                    simulator.episode(i).unwrap().belief().candidates()[pick.unwrap_or(0)]
                        .to_array()
                })
                .collect();
            // Environment 0 of each company starts anew after four steps, with a seed of its own stream.
            let reset: Vec<bool> = seeds.iter().map(|s| s % 3 == 0 && step == 4).collect();
            simulator.step(&commands, &reset, out).unwrap();
        }
        for (i, row) in trace.rows.iter_mut().enumerate() {
            row.extend(
                depth[i * pixels..(i + 1) * pixels]
                    .iter()
                    .map(|v| u64::from(v.to_bits())),
            );
            let scan = &scan[i * rays..(i + 1) * rays];
            row.extend(scan.iter().map(|v| u64::from(v.to_bits())));
            row.extend(
                pose[i * 7..(i + 1) * 7]
                    .iter()
                    .map(|v| u64::from(v.to_bits())),
            );
            row.extend(
                local_map[i * 3 * cells..(i + 1) * 3 * cells]
                    .iter()
                    .map(|v| u64::from(v.to_bits())),
            );
            row.extend(mask[i * k..(i + 1) * k].iter().map(|v| u64::from(*v)));
            row.extend(
                metrics[i * METRICS.len()..(i + 1) * METRICS.len()]
                    .iter()
                    .map(|v| v.to_bits()),
            );
        }
    }
    trace
}

#[test]
fn company_and_threads_change_nothing() {
    for make in [six, lively, || {
        setup(ViewSpace::dome(4, 8, 0.5, -0.5, 0.9).unwrap())
    }] {
        let seeds = [3, 5, 7, 9, 11];
        let alone: Vec<Vec<u64>> = seeds
            .iter()
            .flat_map(|s| run(make(), &[*s], 1, 6).rows)
            .collect();
        for threads in [1, 2, 3] {
            let together = run(make(), &seeds, threads, 6);
            assert!(together.rows == alone, "{threads} threads");
        }
    }
}

#[test]
fn looking_around_gains_information_and_the_books_balance() {
    let mut simulator =
        Simulator::new(setup(ViewSpace::dome(6, 12, 0.5, -0.6, 1.0).unwrap()), 1, 1).unwrap();
    let mut row = vec![0f64; METRICS.len()];
    let column = |name: &str| METRICS.iter().position(|m| *m == name).unwrap();
    simulator
        .reset(
            &[true],
            &[Some(1)],
            Buffers {
                metrics: Some(&mut row),
                ..Buffers::default()
            },
        )
        .unwrap();
    let first = row.clone();
    assert!(
        first[column("coverage")] > 0.0
            && first[column("views")] == 1.0
            && first[column("travel")] == 0.0
    );
    let (mut bits, mut surface) = (0.0, 0.0);
    for step in 0..12 {
        let goal = simulator.episode(0).unwrap().belief().candidates()[(step * 31) % 72].to_array();
        simulator
            .step(
                &[goal],
                &[false],
                Buffers {
                    metrics: Some(&mut row),
                    ..Buffers::default()
                },
            )
            .unwrap();
        bits += row[column("information_gain_bits")];
        surface += row[column("new_surface_voxels")];
        let belief = simulator.episode(0).unwrap().belief();
        let octree = belief.octree();
        assert_eq!(
            octree.recount(),
            (
                octree.num_known(),
                octree.num_occupied(),
                octree.entropy(),
                octree.information()
            )
        );
    }
    // Gains add up to the difference between the last and the first map.
    assert!((first[column("entropy")] - row[column("entropy")] - bits).abs() < 1e-6 && bits > 0.0);
    let reachable = simulator.episode(0).unwrap().truth().count() as f64;
    assert!(
        ((row[column("coverage")] - first[column("coverage")]) * reachable - surface).abs() < 1e-6
    );
    assert!(
        row[column("coverage")] > 0.2 && row[column("coverage")] <= 1.0,
        "coverage {}",
        row[column("coverage")]
    );
}

#[test]
fn an_oracle_foresees_what_then_happens() {
    let mut simulator = Simulator::new(six(), 1, 2).unwrap();
    simulator
        .reset(&[true], &[Some(4)], Buffers::default())
        .unwrap();
    for _ in 0..4 {
        let goals = simulator.episode(0).unwrap().belief().candidates().to_vec();
        let foreseen = simulator.foresee(0, &goals).unwrap();
        let mut row = vec![0f64; METRICS.len()];
        simulator
            .step(
                &[goals[2].to_array()],
                &[false],
                Buffers {
                    metrics: Some(&mut row),
                    ..Buffers::default()
                },
            )
            .unwrap();
        assert_eq!(foreseen[2].to_vec(), row);
    }
}

#[test]
fn bodies_are_foreseen_as_they_then_move() {
    let mut simulator = Simulator::new(lively(), 1, 1).unwrap();
    simulator
        .reset(&[true], &[Some(2)], Buffers::default())
        .unwrap();
    let begin = simulator.episode(0).unwrap().world().bodies().clone();
    for step in 0..6 {
        let goal = simulator.episode(0).unwrap().belief().candidates()[step];
        let foreseen = simulator.foresee(0, &[goal]).unwrap();
        let mut row = vec![0f64; METRICS.len()];
        let out = Buffers {
            metrics: Some(&mut row),
            ..Buffers::default()
        };
        simulator.step(&[goal.to_array()], &[false], out).unwrap();
        assert_eq!(foreseen[0].to_vec(), row);
    }
    assert_ne!(*simulator.episode(0).unwrap().world().bodies(), begin);
}

#[test]
fn bad_commands_change_nothing() {
    let mut simulator = Simulator::new(six(), 2, 1).unwrap();
    assert!(
        simulator
            .step(&[[0.0; 7]; 2], &[false; 2], Buffers::default())
            .is_err(),
        "step before reset"
    );
    simulator
        .reset(&[true; 2], &[Some(1), Some(2)], Buffers::default())
        .unwrap();
    let before: Vec<_> = (0..2)
        .map(|i| *simulator.episode(i).unwrap().metrics())
        .collect();
    let good = simulator.episode(0).unwrap().belief().pose().to_array();
    for bad in [[f32::NAN; 7], [0.0; 7], [1e9, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]] {
        let error = simulator
            .step(&[good, bad], &[false; 2], Buffers::default())
            .unwrap_err()
            .to_string();
        assert!(error.contains("environment 1"), "{error}");
    }
    assert!(simulator
        .step(&[good], &[false; 2], Buffers::default())
        .is_err());
    let after: Vec<_> = (0..2)
        .map(|i| *simulator.episode(i).unwrap().metrics())
        .collect();
    assert_eq!(before, after);
}
