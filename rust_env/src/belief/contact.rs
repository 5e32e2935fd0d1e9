//! What the robot learnt by touch: goals that it was sent to and did not reach.
use crate::geometry::Vec3;

/// A goal that was not reached, and how near to it the robot ever came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Missed {
    pub goal: Vec3,
    /// Metres.
    pub nearest: f32,
}

/// Something that no image shows may stand in the way (a thin leg, a pane, what was looked past). A planner that trusts
/// the map alone bumps into it again and again. So goals nearer to a missed one than the robot ever came to it are not
/// admissible for the rest of the episode, or until the robot comes nearer.
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
        if nearest > tolerance && !self.missed.iter().any(|m| m.goal == goal) {
            self.missed.push(Missed { goal, nearest });
        }
    }

    pub fn allow(&self, goal: Vec3) -> bool {
        self.missed
            .iter()
            .all(|m| goal.distance(m.goal) >= m.nearest)
    }

    pub fn missed(&self) -> &[Missed] {
        &self.missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missed_goal_and_what_lies_around_it_is_barred_until_the_robot_comes_nearer() {
        let mut contacts = Contacts::default();
        let goal = Vec3::X * 2.0;
        contacts.learn(Vec3::Y, Vec3::Y * 1.04, 0.05, f32::INFINITY);
        assert!(contacts.missed().is_empty() && contacts.allow(Vec3::Y));
        contacts.learn(goal, Vec3::X, 0.05, f32::INFINITY);
        contacts.learn(goal, Vec3::X, 0.05, f32::INFINITY);
        assert_eq!(contacts.missed(), [Missed { goal, nearest: 1.0 }]);
        assert!(
            !contacts.allow(goal)
                && !contacts.allow(Vec3::X * 1.1)
                && !contacts.allow(Vec3::X * 2.9)
        );
        assert!(contacts.allow(Vec3::X) && contacts.allow(Vec3::X * 3.0));
        // From the other side it comes to half a metre.
        contacts.learn(Vec3::X * 2.5, Vec3::X * 2.5, 0.05, f32::INFINITY);
        assert!(contacts.allow(Vec3::X * 1.5) && !contacts.allow(Vec3::X * 1.6));
        contacts.learn(goal, goal, 0.05, f32::INFINITY);
        assert!(contacts.missed().is_empty() && contacts.allow(goal));
        contacts.learn(goal, Vec3::ZERO, 0.05, 0.2);
        assert!(!contacts.allow(goal + Vec3::X * 0.19) && contacts.allow(goal + Vec3::X * 0.21));
    }
}
