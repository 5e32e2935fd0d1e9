//! People: upright capsules that walk along way-points.
use crate::error::{positive, Error, Result};
use crate::geometry::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// A person's radius and height, metres.
pub const RADIUS: f32 = 0.28;
pub const HEIGHT: f32 = 1.8;
/// Metres per second; Gazebo's actors walk so.
pub const SPEED: f32 = 0.8;
/// Fastest walk, metres per second: far less than a radius in a tick.
const MAX_SPEED: f64 = 10.0;
const MAX_WAY_POINTS: usize = 10_000;

/// Somebody who walks along `path` at a steady speed. Where they are follows from the metres they have walked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Walker {
    /// Way-points on the floor, metres; one is a place to stand.
    pub path: Vec<Vec2>,
    /// From the last way-point to the first and round again; else back and forth.
    pub round: bool,
    /// Metres per second.
    pub speed: f32,
    pub radius: f32,
    pub height: f32,
    /// Height of the floor under the feet, metres.
    pub floor: f32,
    /// Metres walked, modulo the way round (or out and back).
    pub walked: f64,
}

impl Walker {
    /// A walker at the first way-point; the floor is set when an episode begins.
    pub fn new(path: Vec<Vec2>, round: bool, speed: f64, radius: f64, height: f64) -> Result<Self> {
        if path.is_empty() || path.len() > MAX_WAY_POINTS {
            return Err(Error::invalid(format!(
                "walker path must have 1..={MAX_WAY_POINTS} way-points, got {}",
                path.len()
            )));
        }
        // False for NaN.
        let near = |p: &&Vec2| p.abs().cmple(Vec2::splat(1e6)).all();
        if let Some(bad) = path.iter().find(|p| !near(p)) {
            return Err(Error::invalid(format!(
                "walker path must lie within 1e6 m, got {bad}"
            )));
        }
        if positive("walker speed", speed)? > MAX_SPEED {
            return Err(Error::invalid(format!(
                "walker speed must be at most {MAX_SPEED} m/s, got {speed}"
            )));
        }
        if !(0.1..=2.0).contains(&radius) {
            return Err(Error::invalid(format!(
                "walker radius must lie in [0.1, 2] m, got {radius}"
            )));
        }
        if !(2.0 * radius..=10.0).contains(&height) {
            return Err(Error::invalid(format!(
                "walker height must lie in [2 radius = {}, 10] m, got {height}",
                2.0 * radius
            )));
        }
        Ok(Self {
            path,
            round,
            speed: speed as f32,
            radius: radius as f32,
            height: height as f32,
            floor: 0.0,
            walked: 0.0,
        })
    }

    /// An error if this cannot be a walker's state.
    pub fn check(&self) -> Result<()> {
        let [speed, radius, height] = [self.speed, self.radius, self.height].map(f64::from);
        Self::new(self.path.clone(), self.round, speed, radius, height)?;
        if !(self.floor.abs() <= 1e6 && self.walked.is_finite()) {
            return Err(Error::invalid(format!(
                "a walker's floor and way must be finite, got {} and {}",
                self.floor, self.walked
            )));
        }
        Ok(())
    }

    fn legs(&self) -> impl Iterator<Item = (Vec2, Vec2)> + '_ {
        let n = self.path.len();
        let last = if self.round { n } else { n - 1 };
        (0..last).map(move |i| (self.path[i], self.path[(i + 1) % n]))
    }

    /// Metres until the walk repeats itself; 0 for somebody who stands.
    pub fn period(&self) -> f64 {
        let once: f64 = self.legs().map(|(a, b)| f64::from(a.distance(b))).sum();
        if self.round {
            once
        } else {
            2.0 * once
        }
    }

    /// The feet after so many metres.
    pub fn feet(&self, walked: f64) -> Vec3 {
        let period = self.period();
        let mut left = if period > 0.0 {
            walked.rem_euclid(period)
        } else {
            0.0
        };
        if !self.round {
            left = left.min(period - left);
        }
        let mut at = self.path[0];
        for (a, b) in self.legs() {
            let length = f64::from(a.distance(b));
            if left <= length {
                let share = if length > 0.0 { left / length } else { 0.0 };
                at = a.lerp(b, share as f32);
                break;
            }
            left -= length;
            at = b;
        }
        at.extend(self.floor)
    }

    /// Metres walked one tick of `seconds` later.
    pub fn next(&self, seconds: f64) -> f64 {
        let period = self.period();
        if period > 0.0 {
            (self.walked + f64::from(self.speed) * seconds).rem_euclid(period)
        } else {
            0.0
        }
    }

    /// Where the feet are now.
    pub fn position(&self) -> Vec3 {
        self.feet(self.walked)
    }

    /// The point of the capsule's axis nearest to `p`, for feet at `feet`: the body is what is within `radius` of it.
    pub fn axis_near(&self, feet: Vec3, p: Vec3) -> Vec3 {
        let low = feet.z + self.radius;
        let high = feet.z + self.height - self.radius;
        Vec3::new(feet.x, feet.y, p.z.clamp(low, high.max(low)))
    }
}
