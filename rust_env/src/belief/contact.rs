//! What the robot learnt by touch: goals that it was sent to and did not reach.
use crate::geometry::Vec3;

/// The cosine of the angle to the way to a missed goal within which other goals are behind the same thing: 60 degrees.
const BEHIND: f32 = 0.5;

/// A goal that was not reached, where the robot was stopped, and how near to the goal it ever came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Missed {
    pub goal: Vec3,
    pub stopped: Vec3,
    /// Metres.
    pub nearest: f32,
}

impl Missed {
    /// Is another goal nearer to this one than the robot ever came, and behind what stopped it?
    fn bars(&self, goal: Vec3) -> bool {
        let (way, other) = (self.goal - self.stopped, goal - self.stopped);
        goal.distance(self.goal) < self.nearest
            && way.dot(other) >= BEHIND * way.length() * other.length()
    }
}

/// Something that no image shows may stand in the way (a thin leg, a pane, what was looked past). A planner that trusts
/// the map alone bumps into it again and again. So goals behind it that are nearer to a missed one than the robot ever came
/// are not admissible for the rest of the episode, or until the robot comes nearer.
#[derive(Clone, Debug, Default)]
pub struct Contacts {
    missed: Vec<Missed>,
}

impl Contacts {
    pub fn new(missed: Vec<Missed>) -> Self {
        Self { missed }
    }

    /// The robot was sent to `goal` and is at `reached`; distances up to `tolerance` metres are none. No goal farther than
    /// `most` metres from the missed one is barred.
    pub fn learn(&mut self, goal: Vec3, reached: Vec3, tolerance: f32, most: f32) {
        for missed in &mut self.missed {
            missed.nearest = missed.nearest.min(missed.goal.distance(reached));
        }
        self.missed.retain(|m| m.nearest > tolerance);
        let nearest = goal.distance(reached).min(most);
        let known = |m: &Missed| m.goal == goal && m.stopped == reached;
        if nearest > tolerance && !self.missed.iter().any(known) {
            self.missed.push(Missed {
                goal,
                stopped: reached,
                nearest,
            });
        }
    }

    pub fn allow(&self, goal: Vec3) -> bool {
        !self.missed.iter().any(|m| m.bars(goal))
    }

    pub fn missed(&self) -> &[Missed] {
        &self.missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missed_goal_and_what_lies_behind_is_barred_until_the_robot_comes_nearer() {
        let mut contacts = Contacts::default();
        let goal = Vec3::X * 2.0;
        contacts.learn(Vec3::Y, Vec3::Y * 1.04, 0.05, f32::INFINITY);
        assert!(contacts.missed().is_empty() && contacts.allow(Vec3::Y));
        contacts.learn(goal, Vec3::X, 0.05, f32::INFINITY);
        contacts.learn(goal, Vec3::X, 0.05, f32::INFINITY);
        let (stopped, nearest) = (Vec3::X, 1.0);
        assert_eq!(
            contacts.missed(),
            [Missed {
                goal,
                stopped,
                nearest
            }]
        );
        assert!(
            !contacts.allow(goal)
                && !contacts.allow(Vec3::X * 1.1)
                && !contacts.allow(Vec3::X * 2.9)
        );
        assert!(contacts.allow(Vec3::X * 0.99) && contacts.allow(Vec3::X * 3.0));
        // Beside: 59 and 61 degrees off the way, both within a metre of the goal.
        let aside = |degrees: f32| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Vec3::X + Vec3::new(cos, sin, 0.0) * 0.9
        };
        assert!(!contacts.allow(aside(59.0)) && contacts.allow(aside(61.0)));
        assert!(aside(61.0).distance(goal) < 1.0);
        // From the other side it comes to half a metre.
        contacts.learn(Vec3::X * 2.5, Vec3::X * 2.5, 0.05, f32::INFINITY);
        assert!(contacts.allow(Vec3::X * 1.5) && !contacts.allow(Vec3::X * 1.6));
        contacts.learn(goal, goal, 0.05, f32::INFINITY);
        assert!(contacts.missed().is_empty() && contacts.allow(goal));
        // Stopped on another way to the same goal: what is behind that is barred, too.
        contacts.learn(goal, Vec3::X, 0.05, f32::INFINITY);
        let (behind, there) = (Vec3::new(1.4, 0.72, 0.0), Vec3::new(1.2, 1.0, 0.0));
        assert!(contacts.allow(behind), "61 degrees off the first way");
        contacts.learn(goal, there, 0.05, f32::INFINITY);
        assert!(!contacts.allow(behind));
        contacts.learn(goal, goal, 0.05, f32::INFINITY);
        contacts.learn(goal, Vec3::ZERO, 0.05, 0.2);
        assert!(!contacts.allow(goal + Vec3::X * 0.19) && contacts.allow(goal + Vec3::X * 0.21));
    }
}
