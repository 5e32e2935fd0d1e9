//! Laws of moving bodies: where walkers are, who stops for whom, what pushing does, and that nothing else decides it.
use super::*;
use crate::geometry::{Mesh, Quat, Vec2};
use crate::world::scene::Scene;
use crate::world::test_scenes::*;
use crate::world::{scenes, SceneAssets};
use proptest::prelude::*;
use rand_pcg::Pcg64Mcg;

/// A closed hall of 8 x 6 x 3 m with its corner in the origin.
fn hall() -> SceneShape {
    let mut mesh = Mesh::default();
    let high = Vec3::new(8.0, 6.0, 3.0);
    cuboid(&mut mesh, Vec3::ZERO, high, 1.0, 0.0, &mut random(1));
    SceneShape::new(&Scene {
        bounds: mesh.bounds(),
        visual: mesh,
        ..Scene::default()
    })
}

fn walker(path: &[[f32; 2]], round: bool, speed: f64) -> Walker {
    let path = path.iter().map(|p| Vec2::from_array(*p)).collect();
    Walker::new(path, round, speed, 0.25, 1.8).unwrap()
}

fn cardboard(x: f32, y: f32, z: f32) -> PushedBox {
    PushedBox::new(Vec3::splat(0.4), 60.0, Vec3::new(x, y, z), 0.0).unwrap()
}

fn robot() -> Robot {
    Robot::flying(0.2, 0.5, 1.0).unwrap()
}

/// A robot among bodies.
struct Play {
    shape: SceneShape,
    bodies: Bodies,
    at: Vec3,
    clock: f64,
}

impl Play {
    fn new(bodies: Bodies, at: [f32; 3]) -> Self {
        Self {
            shape: hall(),
            bodies,
            at: at.into(),
            clock: 0.0,
        }
    }

    fn go(&mut self, to: [f32; 3], turn: f32) -> Motion {
        let motion = self.bodies.follow(
            &self.shape,
            &robot(),
            self.at,
            &[to.into()],
            turn,
            &mut self.clock,
        );
        self.at = motion.end;
        motion
    }
}

#[test]
fn walkers_are_where_their_metres_say() {
    let line = walker(&[[1.0, 1.0], [4.0, 1.0], [4.0, 3.0]], false, 1.0);
    assert_eq!(line.period(), 10.0);
    for (walked, x, y) in [
        (0.0, 1.0, 1.0),
        (2.0, 3.0, 1.0),
        (4.0, 4.0, 2.0),
        (5.0, 4.0, 3.0),
        (6.5, 4.0, 1.5),
        (8.0, 3.0, 1.0),
        (12.0, 3.0, 1.0),
    ] {
        let feet = line.feet(walked);
        assert!(
            feet.distance(Vec3::new(x, y, 0.0)) < 1e-5,
            "{walked}: {feet}"
        );
    }
    let round = walker(&[[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]], true, 1.0);
    assert_eq!(round.period(), 12.0);
    assert!(round.feet(9.5).distance(Vec3::new(1.5, 2.0, 0.0)) < 1e-5);
    let standing = walker(&[[2.0, 1.0], [2.0, 1.0]], true, 1.0);
    assert_eq!(standing.next(5.0), 0.0);
    assert_eq!(standing.position(), Vec3::new(2.0, 1.0, 0.0));
}

#[test]
fn bodies_move_by_the_clock_however_it_is_cut() {
    let make = || {
        let bodies = Bodies::new(
            vec![walker(&[[1.0, 1.0], [7.0, 1.0]], false, 0.9)],
            vec![cardboard(4.0, 4.0, 0.6)],
            false,
        );
        Play::new(bodies, [2.0, 5.0, 1.5])
    };
    let (mut whole, mut cut) = (make(), make());
    whole.go([2.0, 3.5, 1.5], 0.0);
    for i in 1..=30 {
        cut.go([2.0, 5.0 - 0.05 * i as f32, 1.5], 0.0);
    }
    assert!((whole.clock - 3.0).abs() < 1e-6 && (cut.clock - 3.0).abs() < 1e-4);
    let (a, b) = (&whole.bodies, &cut.bodies);
    // A rounding of the clock may be worth one tick.
    assert!(a.ticks.abs_diff(b.ticks) <= 1 && a.ticks.abs_diff(360) <= 1);
    let expected = 0.9 * a.ticks as f64 * TICK;
    assert!((a.walkers[0].walked - expected).abs() < 1e-6);
    assert!(a.walkers[0].position().distance(b.walkers[0].position()) < 0.01);
    // The box fell; contacts begin anew at each motion, so that paths differ by little.
    assert!(a.boxes[0].position.distance(b.boxes[0].position) < 0.01);
    assert!((a.boxes[0].position.z - 0.2).abs() < 0.005, "{:?}", a.boxes);
    assert_eq!(a.boxes[0].velocity, Vec3::ZERO);
}

#[test]
fn the_robot_stops_at_people() {
    let bodies = Bodies::new(vec![walker(&[[4.0, 3.0]], false, 1.0)], vec![], true);
    let mut play = Play::new(bodies.clone(), [1.0, 3.0, 1.2]);
    let motion = play.go([7.0, 3.0, 1.2], 0.0);
    assert!(motion.contact);
    // Touching: the sum of the radii and the skin.
    assert!(
        (motion.end.x - (4.0 - 0.45 - SKIN)).abs() < 1e-3,
        "{motion:?}"
    );
    // On, past them and above them.
    assert!(play.go([3.5, 2.0, 1.2], 0.0).travelled > 1.0);
    let mut above = Play::new(bodies, [1.0, 3.0, 2.3]);
    let motion = above.go([7.0, 3.0, 2.3], 0.0);
    assert!(!motion.contact && motion.end.x == 7.0);
}

#[test]
fn people_wait_for_the_robot_and_for_boxes() {
    let walkers = vec![
        walker(&[[1.0, 3.0], [7.0, 3.0]], false, 1.0),
        walker(&[[1.0, 5.0], [7.0, 5.0]], false, 1.0),
    ];
    let bodies = Bodies::new(walkers, vec![cardboard(5.0, 5.0, 0.2)], true);
    let mut play = Play::new(bodies, [4.0, 3.0, 1.2]);
    // Ten seconds on the spot.
    let motion = play.go([4.0, 3.0, 1.2], 10.0);
    assert!(!motion.contact && (play.clock - 10.0).abs() < 1e-5);
    let x = |play: &Play, i: usize| play.bodies.walkers[i].position().x;
    assert!((4.0 - x(&play, 0) - 0.45) < 0.011 && 4.0 - x(&play, 0) > 0.45);
    // The box's side is 0.2 m from its middle; a capsule's lower end is round.
    assert!((4.5..4.8).contains(&x(&play, 1)), "{}", x(&play, 1));
    assert_eq!(play.bodies.boxes[0], cardboard(5.0, 5.0, 0.2));
    let waited = x(&play, 0);
    assert!(!play.go([4.0, 1.0, 1.2], 0.0).contact);
    assert!(x(&play, 0) > waited + 1.0, "they go on");
}

#[test]
fn boxes_are_pushed_and_stop_at_walls() {
    let bodies = Bodies::new(vec![], vec![cardboard(3.0, 3.0, 0.2)], true);
    let mut play = Play::new(bodies, [2.0, 3.0, 0.25]);
    let motion = play.go([4.0, 3.0, 0.25], 0.0);
    assert!(!motion.contact && motion.end.x == 4.0, "{motion:?}");
    let pushed = play.bodies.boxes[0];
    // In front of the ball, on the floor, and not thrown far.
    assert!((4.37..4.7).contains(&pushed.position.x), "{pushed:?}");
    assert!((pushed.position.z - 0.2).abs() < 0.01, "{pushed:?}");
    assert!((pushed.position.y - 3.0).abs() < 0.1);
    // As far as the wall; there both stop.
    let motion = play.go([7.7, 3.0, 0.25], 0.0);
    let pushed = play.bodies.boxes[0];
    assert!(motion.contact && motion.end.x < 7.5, "{motion:?}");
    assert!(
        pushed.position.x < 7.85 && pushed.position.x > 7.6,
        "{pushed:?}"
    );
    assert!(pushed.nearest(play.at).distance(play.at) > 0.2 - PRESS - 0.003);
    // Back off: the box stays and comes to rest.
    assert!(!play.go([6.0, 3.0, 0.25], 0.0).contact);
    play.go([6.0, 3.0, 0.25], 2.0);
    assert!(play.bodies.rested >= REST_TICKS && play.bodies.boxes[0].velocity == Vec3::ZERO);
}

#[test]
fn a_copy_continues_alike() {
    let bodies = Bodies::new(
        vec![walker(&[[1.0, 1.0], [6.0, 5.0], [2.0, 5.0]], true, 1.1)],
        vec![cardboard(3.0, 3.0, 0.2), cardboard(3.1, 3.1, 0.9)],
        false,
    );
    let mut play = Play::new(bodies, [2.0, 3.0, 0.3]);
    play.go([3.0, 3.1, 0.3], 0.5);
    let saved = play.bodies.clone();
    let mut copy = Play {
        bodies: saved,
        shape: hall(),
        ..play
    };
    for to in [[3.5, 3.2, 0.3], [5.0, 2.0, 0.4], [1.0, 5.0, 2.0]] {
        assert_eq!(play.go(to, 0.3), copy.go(to, 0.3));
        assert_eq!(play.bodies, copy.bodies);
    }
    assert!(play.bodies.boxes[0].position != cardboard(3.0, 3.0, 0.2).position);
    fn can_be_saved<T: serde::Serialize + serde::de::DeserializeOwned>() {}
    can_be_saved::<Bodies>();
}

#[test]
fn long_motions_and_nonsense_end() {
    let bodies = Bodies::new(
        vec![walker(&[[1.0, 1.0], [2.0, 1.0]], false, 1.0)],
        vec![],
        true,
    );
    let slow = Robot::flying(0.2, 0.01, 0.01).unwrap();
    let nowhere = SceneShape::new(&Scene::default());
    let mut copy = bodies.clone();
    let mut clock = 0.0;
    let far = [Vec3::new(0.0, 1e6, 5.0)];
    let motion = copy.follow(&nowhere, &slow, Vec3::Z * 5.0, &far, 0.0, &mut clock);
    assert!(!motion.contact && clock > 9.9e7 && copy.ticks == (clock / TICK) as u64);
    for bad in [Vec3::NAN, Vec3::INFINITY, Vec3::splat(f32::MAX)] {
        let motion = copy.follow(&nowhere, &slow, Vec3::Z, &[bad], 0.0, &mut clock);
        assert_eq!((motion.end, motion.travelled), (Vec3::Z, 0.0));
    }
    let wrong = |result: crate::error::Result<Walker>, field: &str| {
        let error = result.unwrap_err().to_string();
        assert!(error.contains(field), "{error}");
    };
    let path = vec![Vec2::ZERO, Vec2::ONE];
    wrong(Walker::new(vec![], false, 1.0, 0.3, 1.8), "path");
    wrong(Walker::new(vec![Vec2::NAN], false, 1.0, 0.3, 1.8), "path");
    wrong(Walker::new(path.clone(), false, 0.0, 0.3, 1.8), "speed");
    wrong(Walker::new(path.clone(), false, 11.0, 0.3, 1.8), "speed");
    wrong(
        Walker::new(path.clone(), false, 1.0, f64::NAN, 1.8),
        "radius",
    );
    wrong(Walker::new(path, false, 1.0, 1.0, 1.8), "height");
    for bad in [Vec3::ZERO, Vec3::NAN, Vec3::splat(11.0)] {
        assert!(PushedBox::new(bad, 60.0, Vec3::ZERO, 0.0).is_err());
    }
    assert!(PushedBox::new(Vec3::ONE, 0.0, Vec3::ZERO, 0.0).is_err());
    let many = BodiesSpec {
        drawn_boxes: usize::MAX,
        ..BodiesSpec::default()
    };
    assert!(many.checked().unwrap_err().to_string().contains("boxes"));
}

#[test]
fn every_kind_of_scene_has_room() {
    let spec = BodiesSpec {
        drawn_walkers: 2,
        drawn_boxes: 2,
        ..BodiesSpec::default()
    };
    for kind in scenes::KINDS {
        for seed in 0..4 {
            let assets = SceneAssets::new(scenes::generate(kind, seed).unwrap()).unwrap();
            let start = assets.starts[0].0;
            let draw = |mut rng: Pcg64Mcg| spec.draw(&assets, 0.1, 0.1, start, &mut rng).unwrap();
            let bodies = draw(random(seed));
            assert_eq!(bodies, draw(random(seed)));
            assert_ne!(bodies, draw(random(seed + 100)));
            assert_eq!((bodies.walkers.len(), bodies.boxes.len()), (2, 2));
            for walker in &bodies.walkers {
                // All along the way, and not where the robot begins.
                assert!(walker.period() > 1.0);
                for i in 0..40 {
                    let feet = walker.feet(walker.period() * f64::from(i) / 80.0);
                    let z = feet.z + 1.0;
                    assert!(assets.shape.clearance(feet.with_z(z), 1.0) > walker.radius);
                }
                let gap = walker.position().truncate().distance(start.truncate());
                assert!(gap > walker.radius + 0.1);
            }
            for pushed in &bodies.boxes {
                assert!(
                    assets.shape.clearance(pushed.position, 1.0) > 0.14,
                    "{pushed:?}"
                );
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20))]
    /// Whatever happens, robot and walkers keep apart, boxes stay in the hall, and nothing jumps.
    #[test]
    fn nobody_is_run_over(seed in 0u64..10_000) {
        let mut r = random(seed);
        let mut somewhere = |low: f32, high: f32| [uniform(&mut r, low, 7.3), uniform(&mut r, low, 5.3), uniform(&mut r, 0.3, high)];
        let walkers = (0..3).map(|_| {
            let (a, b) = (somewhere(0.7, 0.5), somewhere(0.7, 0.5));
            walker(&[[a[0], a[1]], [b[0], b[1]]], false, 1.2)
        });
        let mut bodies = Bodies::new(walkers.collect(), vec![], false);
        for _ in 0..2 {
            let [x, y, z] = somewhere(0.7, 1.0);
            bodies.boxes.push(cardboard(x, y, z));
        }
        let begin = somewhere(0.7, 2.5);
        let mut play = Play::new(bodies, begin);
        let apart = |play: &Play| play.bodies.walkers.iter().map(|w| {
            (w.axis_near(w.position(), play.at) - play.at).length() - w.radius - 0.2
        }).fold(f32::INFINITY, f32::min);
        let mut gap = apart(&play).min(0.0);
        for _ in 0..6 {
            let before = play.at;
            let to = somewhere(0.5, 2.5);
            let motion = play.go(to, 0.5);
            prop_assert!(before.distance(motion.end) <= motion.travelled + 1e-4);
            prop_assert!(motion.contact || motion.end == Vec3::from_array(to));
            // Who was too near from the beginning may be so still, but not more.
            prop_assert!(apart(&play) >= gap - 2e-3, "{} after {gap}", apart(&play));
            gap = apart(&play).min(0.0);
            for pushed in &play.bodies.boxes {
                let low = Vec3::splat(0.1);
                let high = Vec3::new(7.9, 5.9, 2.9);
                prop_assert!(pushed.position.clamp(low, high) == pushed.position, "{pushed:?}");
                prop_assert!((Quat::length(pushed.rotation) - 1.0).abs() < 1e-3);
            }
        }
    }
}

#[test]
fn is_cheap() {
    let mut cost = Vec::new();
    for (people, boxes) in [(4, 0), (0, 4), (4, 4)] {
        let walkers = (0..people).map(|i| {
            let y = 1.0 + i as f32;
            walker(&[[0.5, y], [7.5, y]], false, 1.0)
        });
        // In the air, so that all are awake.
        let boxes = (0..boxes).map(|i| cardboard(1.0 + 1.5 * i as f32, 5.5, 1.2));
        let bodies = Bodies::new(walkers.collect(), boxes.collect(), false);
        let mut play = Play::new(bodies, [4.0, 5.0, 2.7]);
        let begin = thread_seconds();
        play.go([4.0, 5.0, 2.7], 2.0);
        let seconds = thread_seconds() - begin;
        cost.push(1e6 * seconds / play.bodies.ticks as f64);
    }
    eprintln!(
        "us per tick: 4 walkers {:.2}, 4 boxes {:.1}, both {:.1}",
        cost[0], cost[1], cost[2]
    );
    // Generous: the machine may be busy.
    assert!(cost.iter().all(|us| *us < 2000.0));
}
