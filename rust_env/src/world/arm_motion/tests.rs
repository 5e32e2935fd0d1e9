use super::*;
use crate::geometry::{Mesh, Vec2};
use crate::robot::Robot;
use crate::world::bodies::{Bodies, PushedBox, Walker};
use crate::world::motion::Physics;
use crate::world::scene::Scene;
use crate::world::test_scenes::*;
use proptest::prelude::*;

const SHOULDER: Vec3 = Vec3::new(2.6, 1.9, 1.25);
const BALL: f32 = 0.08;

fn shape_of(mesh: Mesh) -> SceneShape {
    SceneShape::new(&Scene {
        bounds: mesh.bounds(),
        visual: mesh,
        ..Scene::default()
    })
}

fn arm() -> Arm {
    Arm::new(0.425, 0.392, 0.06).unwrap()
}

/// Degrees around and above the shoulder, metres from it.
fn hand(azimuth: f32, pitch: f32, radius: f32) -> Vec3 {
    let (sy, cy) = azimuth.to_radians().sin_cos();
    let (sp, cp) = pitch.to_radians().sin_cos();
    SHOULDER + Vec3::new(cy * cp, sy * cp, sp) * radius
}

/// Least distance of surfaces to points of the axis, less the radius: nothing shared with [`SceneShape::room`].
fn sampled_room(shape: &SceneShape, capsule: &Capsule, samples: u32) -> f32 {
    (0..=samples)
        .map(|i| capsule.a.lerp(capsule.b, i as f32 / samples as f32))
        .map(|p| shape.clearance(p, 10.0))
        .fold(f32::INFINITY, f32::min)
        - capsule.radius
}

#[test]
fn room_is_the_distance_of_the_nearest_point() {
    let mut r = random(3);
    let mut shape = shape_of(soup(150, 4));
    let mut close = 0;
    for i in 0..400 {
        if i == 200 {
            shape.ground = Some(-1.0);
        }
        let mut corner = || within(&mut r, Vec3::splat(-2.5), Vec3::splat(2.5));
        let (a, b) = (corner(), corner());
        let b = if i % 3 == 0 { a } else { a + (b - a) * 0.2 };
        let capsule = Capsule::new(a, b, 0.07);
        let (found, sampled) = (
            shape.room(&capsule, 9.0),
            sampled_room(&shape, &capsule, 60),
        );
        // Samples lie up to 1 cm from the nearest point.
        assert!(
            found <= sampled + 1e-5 && found >= sampled - 0.012,
            "{found} {sampled}"
        );
        assert!((shape.room(&capsule, 0.1) - found.min(0.1)).abs() < 1e-6);
        close += usize::from(found < 0.1);
    }
    assert!(close > 50, "{close}");
}

#[test]
fn a_panel_above_the_elbow_stops_the_arm_but_no_ball() {
    // At a quarter turn the elbow rises to 0.28 m above the shoulder, 0.32 m out; the panel hangs in its way.
    let mut mesh = Mesh::default();
    let corner = SHOULDER + Vec3::new(-0.2, 0.15, 0.3);
    sheet(
        &mut mesh,
        corner,
        Vec3::X * 0.4,
        Vec3::Y * 0.3,
        0.5,
        0.0,
        &mut random(1),
    );
    let shape = shape_of(mesh);
    let start = hand(0.0, 0.0, 0.6);
    let arc: Vec<Vec3> = (1..=36).map(|i| hand(5.0 * i as f32, 0.0, 0.6)).collect();
    let ball = Physics::new(&shape, BALL, start).follow(&arc);
    assert!(!ball.contact && ball.end == arc[35]);
    let mut standing = StandingArm::new(&arm(), BALL, SHOULDER, start);
    let motion = standing.follow(&shape, start, &[hand(170.0, 0.0, 0.6)], STEP, |_, _, _| {
        true
    });
    let turned = (motion.end - SHOULDER).truncate().to_angle().to_degrees();
    assert!(motion.contact && (30.0..80.0).contains(&turned), "{turned}");
    assert!(
        (motion.travelled - 0.6 * turned.to_radians()).abs() < 2e-3,
        "{motion:?}"
    );
    let [upper, fore, camera] = standing.parts();
    let nearest = shape.room(&upper, 1.0).min(shape.room(&fore, 1.0));
    assert!(
        (SKIN..0.012).contains(&nearest) && shape.room(&camera, 1.0) > 0.1,
        "{nearest}"
    );
    assert_eq!(camera.a, fore.b);
    // There and back, and the other way round.
    let back = standing.follow(&shape, motion.end, &[start], STEP, |_, _, _| true);
    assert!(!back.contact && back.end == start);
    let round = [hand(-90.0, 0.0, 0.6), hand(-180.0, 0.0, 0.6)];
    let round = standing.follow(&shape, start, &round, STEP, |_, _, _| true);
    assert!(!round.contact && (round.travelled - 0.6 * std::f32::consts::PI).abs() < 2e-3);
    // Below the panel at a lower pitch: the elbow keeps away.
    let low = [
        hand(-90.0, -40.0, 0.6),
        hand(0.0, -40.0, 0.6),
        hand(90.0, -40.0, 0.6),
    ];
    assert!(
        !standing
            .follow(&shape, round.end, &low, STEP, |_, _, _| true)
            .contact
    );
}

#[test]
fn a_needle_does_not_pass_through_paper() {
    let mut mesh = Mesh::default();
    let corner = SHOULDER + Vec3::new(-1.0, 0.3, -1.0);
    sheet(
        &mut mesh,
        corner,
        Vec3::X * 2.0,
        Vec3::Z * 2.0,
        0.5,
        0.0,
        &mut random(1),
    );
    let shape = shape_of(mesh);
    let needle = Arm::new(0.425, 0.392, 1e-6).unwrap();
    let start = hand(0.0, 0.0, 0.6);
    for step in [STEP, 1.0] {
        let mut standing = StandingArm::new(&needle, 1e-6, SHOULDER, start);
        let motion = standing.follow(&shape, start, &[hand(90.0, 0.0, 0.6)], step, |_, _, _| true);
        let reached = motion.end.y - SHOULDER.y;
        assert!(
            motion.contact && (0.297..0.2991).contains(&reached),
            "{reached}"
        );
    }
}

#[test]
fn what_is_out_of_reach_is_approached_and_nonsense_moves_nothing() {
    let shape = shape_of(Mesh::default());
    let start = hand(10.0, 5.0, 0.6);
    let mut standing = StandingArm::new(&arm(), BALL, SHOULDER, start);
    let motion = standing.follow(
        &shape,
        start,
        &[start, hand(10.0, 5.0, 3.0)],
        STEP,
        |_, _, _| true,
    );
    assert!(
        !motion.contact && motion.end.distance(hand(10.0, 5.0, 0.817)) < 1e-4,
        "{motion:?}"
    );
    for bad in [Vec3::NAN, Vec3::INFINITY, Vec3::splat(f32::MAX)] {
        let still = standing.follow(&shape, motion.end, &[bad], STEP, |_, _, _| true);
        assert_eq!(
            (still.end, still.travelled, still.contact),
            (motion.end, 0.0, false)
        );
    }
    let inside = standing.follow(&shape, motion.end, &[SHOULDER], STEP, |_, _, _| true);
    assert!((inside.end.distance(SHOULDER) - 0.033).abs() < 1e-4);
    assert!(!shape.has_room(&arm(), BALL, SHOULDER, hand(0.0, 0.0, 0.9)));
    assert!(shape.has_room(&arm(), BALL, SHOULDER, hand(0.0, 0.0, 0.8)));
}

#[test]
fn a_saved_arm_goes_on_alike_and_impossible_ones_are_refused() {
    let shape = shape_of(room(0.3));
    let start = hand(0.0, 30.0, 0.6);
    let mut standing = StandingArm::new(&arm(), BALL, SHOULDER, start);
    let mut end = standing
        .follow(&shape, start, &[hand(140.0, 10.0, 0.7)], STEP, |_, _, _| {
            true
        })
        .end;
    let mut copy = StandingArm::load(&arm(), BALL, standing.save()).unwrap();
    for target in [
        hand(-150.0, 50.0, 0.5),
        hand(20.0, -70.0, 0.8),
        hand(200.0, 0.0, 0.6),
    ] {
        let motion = standing.follow(&shape, end, &[target], STEP, |_, _, _| true);
        assert_eq!(
            copy.follow(&shape, end, &[target], STEP, |_, _, _| true),
            motion
        );
        assert_eq!(copy.save(), standing.save());
        end = motion.end;
    }
    let good = standing.save();
    for (i, value) in [
        (0, f32::NAN),
        (1, 1e7),
        (3, 4.0),
        (4, -2.0),
        (5, 0.9),
        (5, 0.0),
        (5, f32::NAN),
    ] {
        let mut bad = good;
        bad[i] = value;
        let error = StandingArm::load(&arm(), BALL, bad)
            .unwrap_err()
            .to_string();
        assert!(error.contains("arm that reaches 0.03"), "{error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    /// Wherever it is sent, no part of the arm comes nearer than a hair to any surface, nor does it jump.
    #[test]
    fn never_enters_or_tunnels(seed in 0u64..1000) {
        let mut r = random(seed);
        let shape = shape_of(if seed % 2 == 0 { room(0.4) } else { soup(25, seed) });
        let arm = arm();
        let mut draw = |low: f32, high: f32| uniform(&mut r, low, high);
        let start = (0..300).find_map(|_| {
            let shoulder = Vec3::new(draw(0.2, 4.0), draw(0.2, 3.0), draw(0.3, 1.8));
            let from = shoulder + hand(draw(-180.0, 180.0), draw(-60.0, 60.0), 0.6) - SHOULDER;
            shape.has_room(&arm, BALL, shoulder, from).then_some((shoulder, from))
        });
        if let Some((shoulder, mut at)) = start {
            let mut standing = StandingArm::new(&arm, BALL, shoulder, at);
            for _ in 0..12 {
                let target = hand(draw(-180.0, 180.0), draw(-90.0, 90.0), draw(0.0, 1.0));
                let target = shoulder + target - SHOULDER;
                let mut worst = (f32::INFINITY, 0.0f32);
                let motion = standing.follow(&shape, at, &[target], STEP, |before, after, _| {
                    for (b, a) in before.iter().zip(after) {
                        worst.1 = worst.1.max(a.moved_from(b));
                        // Between the sub-steps, too.
                        for t in [0.5, 1.0] {
                            let part = Capsule::new(b.a.lerp(a.a, t), b.b.lerp(a.b, t), a.radius);
                            worst.0 = worst.0.min(sampled_room(&shape, &part, 20));
                        }
                    }
                    true
                });
                prop_assert!(worst.0 >= -1e-3, "inside by {}", -worst.0);
                prop_assert!(worst.1 <= STEP + 2e-3, "jumps by {}", worst.1);
                prop_assert!(standing.parts()[2].a.distance(motion.end) < 1e-4);
                prop_assert!(motion.contact || !arm.reaches(shoulder, target) || motion.end == target);
                at = motion.end;
            }
        }
    }
}

/// In an empty hall, with these bodies: how far a quarter turn gets, the clock after it, and the bodies.
fn quarter_turn(mut bodies: Bodies, aside: f32) -> (StandingArm, Motion, f64, Bodies) {
    let mut mesh = Mesh::default();
    let low = SHOULDER - Vec3::new(4.0, 4.0, 1.25);
    cuboid(
        &mut mesh,
        low,
        low + Vec3::new(8.0, 8.0, 3.0),
        1.0,
        0.0,
        &mut random(1),
    );
    let robot = Robot::flying(f64::from(BALL), 0.5, 1.5)
        .unwrap()
        .held_by(arm());
    let start = hand(0.0, aside, 0.6);
    let mut standing = StandingArm::new(&arm(), BALL, SHOULDER, start);
    let mut clock = 0.0;
    let path = [hand(90.0, aside, 0.6)];
    let motion = bodies.follow_arm(
        &shape_of(mesh),
        &robot,
        &mut standing,
        start,
        &path,
        0.0,
        &mut clock,
    );
    (standing, motion, clock, bodies)
}

fn walker(path: &[Vec2]) -> Walker {
    let place = |p: &Vec2| SHOULDER.truncate() + *p;
    Walker::new(path.iter().map(place).collect(), false, 0.5, 0.25, 1.8).unwrap()
}

#[test]
fn people_stop_the_arm_and_wait_for_it() {
    let far = walker(&[Vec2::new(3.0, 3.0)]);
    let (_, free, clock, _) = quarter_turn(Bodies::new(vec![far], vec![], true), 0.0);
    let arc = 0.6 * std::f32::consts::FRAC_PI_2;
    assert!(
        !free.contact && (free.travelled - arc).abs() < 1e-3,
        "{free:?}"
    );
    assert!((clock - f64::from(arc) / 0.5).abs() < 0.01);
    // Somebody stands under the elbow's way, out of the camera's.
    let near = walker(&[Vec2::new(0.25, 0.25)]);
    let (standing, stopped, _, bodies) = quarter_turn(Bodies::new(vec![near], vec![], true), 60.0);
    assert!(stopped.contact && stopped.travelled < free.travelled);
    let axis = |z: f32| bodies.walkers[0].position().with_z(z);
    for part in standing.parts() {
        let (on, other) = nearest_of_segments(part.a, part.b, axis(0.25), axis(1.55));
        assert!(on.distance(other) - 0.25 - part.radius > -1e-4);
    }
    // Somebody who walks towards the arm when it has come to rest stops before it.
    let (from, to) = (Vec2::new(0.0, 2.0), Vec2::new(0.0, -2.0));
    let mut bodies = Bodies::new(vec![walker(&[from, to])], vec![], true);
    let mut mesh = Mesh::default();
    cuboid(
        &mut mesh,
        SHOULDER - 4.0,
        SHOULDER + 4.0,
        1.0,
        0.0,
        &mut random(1),
    );
    let shape = shape_of(mesh);
    let robot = Robot::flying(f64::from(BALL), 0.5, 0.1)
        .unwrap()
        .held_by(arm());
    let at = hand(90.0, 0.0, 0.6);
    let mut standing = StandingArm::new(&arm(), BALL, SHOULDER, at);
    let mut clock = 0.0;
    bodies.follow_arm(&shape, &robot, &mut standing, at, &[], 1.5, &mut clock);
    let stands = bodies.walkers[0].position().y - SHOULDER.y;
    assert!(
        (clock - 15.0).abs() < 1e-3 && (0.93..0.95).contains(&stands),
        "{stands}"
    );
}

#[test]
fn boxes_stop_the_arm_and_stay() {
    let place = SHOULDER + Vec3::new(0.25, 0.25, 0.45);
    let size = Vec3::new(0.2, 0.2, 0.2);
    let pushed = PushedBox::new(size, 60.0, place, 0.3).unwrap();
    // Held where it is: nobody has touched it yet.
    let (standing, motion, _, bodies) = quarter_turn(Bodies::new(vec![], vec![pushed], true), 20.0);
    assert!(motion.contact && motion.travelled > 0.05, "{motion:?}");
    let [upper, fore, camera] = standing.parts();
    for part in [upper, fore, camera] {
        let near = (0..=50).map(|i| part.a.lerp(part.b, i as f32 / 50.0));
        let near = near
            .map(|p| pushed.nearest(p).distance(p))
            .fold(9.0, f32::min);
        assert!(near > part.radius - 1e-3, "{near}");
    }
    assert_eq!(bodies.boxes.len(), 1);
}
