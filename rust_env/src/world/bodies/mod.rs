//! What moves besides the robot: people who walk ([`walker`]) and boxes that are pushed ([`pushed_box`]).
//!
//! Their time runs in ticks of [`TICK`] seconds by the episode's clock, only while the robot moves or turns, so that
//! they depend on nothing but what the robot did. The robot stops at people and pushes boxes; a box that cannot give way
//! stops it. People wait for whatever stands in their way, robot or box, and go on when the way is free. Between
//! motions the state is plain numbers, which can be copied and saved.
mod draw;
mod pushed_box;
mod shapes;
mod walker;

pub use draw::{BodiesSpec, GivenBox, MAX_BODIES};
pub use pushed_box::{PushedBox, DENSITY};
pub use walker::{Walker, HEIGHT, RADIUS, SPEED};

use crate::capsule::{nearest_of_segments, Capsule};
use crate::error::{Error, Result};
use crate::geometry::Vec3;
use crate::robot::Robot;
use crate::world::arm_motion::{Parts, StandingArm, STEP};
use crate::world::motion::{sweep_convex, Motion, SceneShape, SKIN, STILL};
use pushed_box::Stage;
use serde::{Deserialize, Serialize};

/// Seconds of a tick.
pub const TICK: f64 = 1.0 / 120.0;
/// Ticks of one motion, ten minutes; a longer motion finds the bodies at rest after them.
const MAX_TICKS: u32 = 72_000;
/// Longest time of a clock that can be loaded, seconds: beyond what all motions of an episode add up to.
const MAX_TIME: f64 = 1e12;
/// How deep the robot's ball presses into a box that it pushes, metres: a robot that moves farther in a tick (1.2 m/s)
/// stops at boxes instead.
const PRESS: f32 = 0.01;
/// Boxes slower than this, m/s, for so many ticks are at rest.
const REST_SPEED: f32 = 0.05;
const REST_TICKS: u32 = 60;
/// The robot wakes boxes when it comes as near as this, metres.
const WAKE: f32 = 0.02;
/// The slowest robot that may move among bodies, m/s and rad/s: slower ones would need ticks without end.
pub const MIN_ROBOT_SPEED: f32 = 0.01;

/// The moving bodies of one episode.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Bodies {
    pub walkers: Vec<Walker>,
    pub boxes: Vec<PushedBox>,
    /// Ticks since the episode began.
    ticks: u64,
    /// Ticks since a box moved.
    rested: u32,
}

impl Bodies {
    /// `at_rest`: the boxes stand where they are put until they are touched; else they begin by falling.
    pub fn new(walkers: Vec<Walker>, boxes: Vec<PushedBox>, at_rest: bool) -> Self {
        Self {
            walkers,
            boxes,
            ticks: 0,
            rested: if at_rest { REST_TICKS } else { 0 },
        }
    }

    /// An error if this cannot be a state of bodies so many seconds after the episode began; for what comes from outside.
    pub fn check(&self, time: f64) -> Result<()> {
        if self.walkers.len().max(self.boxes.len()) > 2 * MAX_BODIES {
            return Err(Error::invalid(format!(
                "there are at most {} bodies of a kind, got {} walkers and {} boxes",
                2 * MAX_BODIES,
                self.walkers.len(),
                self.boxes.len()
            )));
        }
        // Else the next motion would make up for ticks that never were.
        let behind = time - self.ticks as f64 * TICK;
        if !self.is_empty() && (behind.abs() > 2.0 * TICK + 1e-12 * time || time > MAX_TIME) {
            return Err(Error::invalid(format!(
                "bodies after {} ticks of {TICK} s do not fit a clock that shows {time} s, at most {MAX_TIME} s",
                self.ticks
            )));
        }
        self.walkers.iter().try_for_each(Walker::check)?;
        self.boxes.iter().try_for_each(PushedBox::check)
    }

    pub fn is_empty(&self) -> bool {
        self.walkers.is_empty() && self.boxes.is_empty()
    }

    /// Moves the robot's ball along `path`, as [`crate::world::motion::Physics::follow`] does, and lets it turn by
    /// `turn` radians, while the bodies move. `clock`: seconds since the episode began; it runs on.
    pub fn follow(
        &mut self,
        shape: &SceneShape,
        robot: &Robot,
        from: Vec3,
        path: &[Vec3],
        turn: f32,
        clock: &mut f64,
    ) -> Motion {
        let mut outing = Outing::new(self, shape, robot, *clock);
        let mut motion = Motion {
            end: from,
            travelled: 0.0,
            contact: false,
        };
        for &target in path {
            let length = (target - motion.end).length();
            if !length.is_finite() {
                break;
            }
            if length < STILL {
                continue;
            }
            let gone = outing.straight(motion.end, target, length);
            motion.travelled += gone;
            if gone < length {
                motion.end += (target - motion.end) * (gone / length);
                motion.contact = true;
                break;
            }
            motion.end = target;
        }
        *clock += f64::from(robot.duration(motion.travelled, turn));
        outing.stand(&[Capsule::ball(motion.end, outing.radius)], *clock);
        motion
    }

    /// The same for an arm, as [`StandingArm::follow`] moves it. It stops at boxes and pushes none.
    #[allow(clippy::too_many_arguments)]
    pub fn follow_arm(
        &mut self,
        shape: &SceneShape,
        robot: &Robot,
        arm: &mut StandingArm,
        from: Vec3,
        path: &[Vec3],
        turn: f32,
        clock: &mut f64,
    ) -> Motion {
        let mut outing = Outing::new(self, shape, robot, *clock);
        // So that about one tick falls into a sub-step.
        let step = STEP.min(robot.speed() * TICK as f32);
        let motion = arm.follow(shape, from, path, step, |before, after, metres| {
            outing.passes(before, after, metres)
        });
        *clock += f64::from(robot.duration(motion.travelled, turn));
        outing.stand(&arm.parts(), *clock);
        motion
    }

    /// Whether somebody or something stands where this walker would be; whoever is too near already may walk away.
    fn is_blocked(&self, walker: &Walker, feet: Vec3, robot: &[Capsule]) -> bool {
        let now = walker.position();
        let gap = |feet: Vec3, p: Vec3| (walker.axis_near(feet, p) - p).length() - walker.radius;
        let by_robot = |part: &Capsule| {
            let then = walker_gap(walker, feet, part);
            then < part.radius + SKIN && then < walker_gap(walker, now, part)
        };
        let nearer = |p: Vec3, limit: f32| {
            let then = gap(feet, p);
            then < limit && then < gap(now, p)
        };
        let by_box = |b: &PushedBox| {
            let far = 0.5 * b.size.length() + walker.radius + 0.1;
            if b.position.truncate().distance(feet.truncate()) > far {
                return false;
            }
            // Nearest points by turns: the distance of two convex bodies.
            let mut p = b.position;
            for _ in 0..8 {
                p = b.nearest(walker.axis_near(feet, p));
            }
            nearer(p, SKIN)
        };
        robot.iter().any(by_robot) || self.boxes.iter().any(by_box)
    }
}

/// Metres from the axis of a part of the robot to a walker whose feet are at `feet`.
fn walker_gap(walker: &Walker, feet: Vec3, part: &Capsule) -> f32 {
    let (on, other) = if part.a == part.b {
        (part.a, walker.axis_near(feet, part.a))
    } else {
        let [low, high] = [f32::MIN, f32::MAX].map(|z| walker.axis_near(feet, Vec3::Z * z));
        nearest_of_segments(part.a, part.b, low, high)
    };
    (other - on).length() - walker.radius
}

/// Metres from the axis of a part of the robot to a box.
fn box_gap(pushed: &PushedBox, part: &Capsule) -> f32 {
    let gap = |t: f32| {
        let p = part.a.lerp(part.b, t);
        pushed.nearest(p).distance(p)
    };
    if part.a == part.b {
        return gap(0.0);
    }
    // Convex along the axis.
    let (mut low, mut high) = (0.0f32, 1.0f32);
    for _ in 0..40 {
        let third = (high - low) / 3.0;
        if gap(low + third) <= gap(high - third) {
            high -= third;
        } else {
            low += third;
        }
    }
    gap(0.5 * (low + high)).min(gap(0.0)).min(gap(1.0))
}

/// A motion of the robot in progress.
struct Outing<'a> {
    bodies: &'a mut Bodies,
    shape: &'a SceneShape,
    radius: f32,
    speed: f32,
    /// Where boxes move, while they do.
    stage: Option<Stage>,
    /// Seconds since the episode began.
    now: f64,
    left: u32,
}

impl<'a> Outing<'a> {
    fn new(bodies: &'a mut Bodies, shape: &'a SceneShape, robot: &Robot, now: f64) -> Self {
        Self {
            bodies,
            shape,
            radius: robot.radius(),
            speed: robot.speed(),
            stage: None,
            now,
            left: MAX_TICKS,
        }
    }

    /// When the next tick is.
    fn due(&self) -> f64 {
        if self.left == 0 {
            return f64::INFINITY;
        }
        (self.bodies.ticks + 1) as f64 * TICK
    }

    /// Metres that the ball gets from `from` towards `to`, which is `length` away.
    fn straight(&mut self, from: Vec3, to: Vec3, length: f32) -> f32 {
        let direction = (to - from) / length;
        let reach = self.shape.sweep(from, direction, length, self.radius);
        let mut gone = 0.0;
        let mut robot = from;
        loop {
            let until = (self.due() - self.now).max(0.0) as f32 * self.speed;
            let wish = reach - gone;
            let step = wish.min(until);
            let free = if step > 0.0 {
                self.free(robot, direction, step)
            } else {
                0.0
            };
            gone += free;
            let before = robot;
            robot = from + direction * gone;
            self.now += f64::from(free / self.speed);
            if free < step {
                return gone;
            }
            if step >= wish {
                return if reach < length { reach } else { length };
            }
            self.now = self.due();
            let ball = |center| [Capsule::ball(center, self.radius)];
            self.tick(&ball(before), &ball(robot));
        }
    }

    /// Whether an arm meets no body in a sub-step in which its hand moves so many metres; if so, the clock runs on.
    fn passes(&mut self, before: &Parts, after: &Parts, metres: f32) -> bool {
        let meets = |gap: &dyn Fn(&Capsule) -> f32| {
            before.iter().zip(after).any(|(before, after)| {
                let then = gap(after) - after.radius;
                // Whoever is too near already may go away.
                then < SKIN && then < gap(before) - before.radius
            })
        };
        let walkers = &self.bodies.walkers;
        if walkers
            .iter()
            .any(|w| meets(&|part| walker_gap(w, w.position(), part)))
            || self
                .bodies
                .boxes
                .iter()
                .any(|b| meets(&|part| box_gap(b, part)))
        {
            return false;
        }
        self.now += f64::from(metres / self.speed);
        let mut from = before;
        while self.due() <= self.now {
            self.tick(from, after);
            from = after;
        }
        true
    }

    /// The robot stays, turning perhaps, until the clock shows `end`.
    fn stand(&mut self, robot: &[Capsule], end: f64) {
        while self.due() <= end {
            self.now = self.due();
            self.tick(robot, robot);
        }
        // A motion beyond all measure: time went by without ticks.
        self.bodies.ticks = self.bodies.ticks.max((end / TICK) as u64);
    }

    /// How far the ball can go before it meets a body.
    fn free(&self, robot: Vec3, direction: Vec3, length: f32) -> f32 {
        let mut free = length;
        for walker in &self.bodies.walkers {
            let feet = walker.position();
            free = sweep_convex(robot, direction, free, self.radius + walker.radius, |p| {
                walker.axis_near(feet, p)
            });
        }
        let pressed = self.radius - PRESS.min(0.5 * self.radius);
        for pushed in &self.bodies.boxes {
            free = sweep_convex(robot, direction, free, pressed, |p| pushed.nearest(p));
        }
        free
    }

    /// The robot's parts went from `before` to `robot` since the last tick.
    fn tick(&mut self, before: &[Capsule], robot: &[Capsule]) {
        self.left -= 1;
        self.bodies.ticks += 1;
        for i in 0..self.bodies.walkers.len() {
            let walker = &self.bodies.walkers[i];
            let walked = walker.next(TICK);
            let feet = walker.feet(walked);
            if !self.bodies.is_blocked(walker, feet, robot) {
                self.bodies.walkers[i].walked = walked;
            }
        }
        self.push(before, robot);
    }

    fn push(&mut self, before: &[Capsule], robot: &[Capsule]) {
        let Bodies {
            walkers,
            boxes,
            rested,
            ..
        } = &mut *self.bodies;
        let moved = robot.iter().zip(before).map(|(r, b)| r.moved_from(b));
        let moved = moved.fold(0.0, f32::max);
        let touches = |b: &PushedBox| {
            let mut parts = robot.iter();
            parts.any(|part| box_gap(b, part) < part.radius + WAKE + moved)
        };
        if moved > 0.0 && boxes.iter().any(touches) {
            *rested = 0;
        }
        if boxes.is_empty() || *rested >= REST_TICKS {
            self.stage = None;
            return;
        }
        let shape = self.shape;
        let stage = self
            .stage
            .get_or_insert_with(|| Stage::new(shape, before, walkers, boxes));
        stage.step(robot, walkers, boxes);
        *rested = if boxes.iter().all(|b| b.speed() < REST_SPEED) {
            *rested + 1
        } else {
            0
        };
        if *rested >= REST_TICKS {
            for pushed in boxes {
                (pushed.velocity, pushed.spin) = (Vec3::ZERO, Vec3::ZERO);
            }
        }
    }
}

#[cfg(test)]
mod tests;
