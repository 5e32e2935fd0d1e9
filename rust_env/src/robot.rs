//! The robot's own body: what both wings must know about it.
use crate::arm::Arm;
use crate::error::{positive, Result};

#[derive(Clone, Debug, PartialEq)]
pub enum Robot {
    /// A free-flying camera inside a sphere.
    Flying {
        /// Radius of the body, metres.
        radius: f32,
        /// Metres per second and radians per second; they turn a path into simulated time.
        speed: f32,
        turn_rate: f32,
    },
    /// A camera in the hand of an arm whose shoulder stands at the centre of a dome.
    Arm {
        /// Radius of the ball around the camera, metres.
        radius: f32,
        /// Of the hand, metres per second, and of the camera, radians per second.
        speed: f32,
        turn_rate: f32,
        arm: Arm,
    },
}

impl Robot {
    pub fn flying(radius: f64, speed: f64, turn_rate: f64) -> Result<Self> {
        Ok(Self::Flying {
            radius: positive("robot radius", radius)? as f32,
            speed: positive("robot speed", speed)? as f32,
            turn_rate: positive("robot turn_rate", turn_rate)? as f32,
        })
    }

    /// This body and motion, in the hand of an arm.
    pub fn held_by(self, arm: Arm) -> Self {
        Self::Arm {
            radius: self.radius(),
            speed: self.speed(),
            turn_rate: self.turn_rate(),
            arm,
        }
    }

    pub fn arm(&self) -> Option<&Arm> {
        match self {
            Robot::Flying { .. } => None,
            Robot::Arm { arm, .. } => Some(arm),
        }
    }

    /// Radius of the ball around the camera, metres.
    pub fn radius(&self) -> f32 {
        let (Robot::Flying { radius, .. } | Robot::Arm { radius, .. }) = self;
        *radius
    }

    /// Metres per second along a path.
    pub fn speed(&self) -> f32 {
        let (Robot::Flying { speed, .. } | Robot::Arm { speed, .. }) = self;
        *speed
    }

    /// Radians per second.
    pub fn turn_rate(&self) -> f32 {
        let (Robot::Flying { turn_rate, .. } | Robot::Arm { turn_rate, .. }) = self;
        *turn_rate
    }

    /// Seconds for a path of `length` metres that ends with a turn of `angle` radians (both run at once).
    pub fn duration(&self, length: f32, angle: f32) -> f32 {
        (length / self.speed()).max(angle / self.turn_rate())
    }
}
