//! How an arm moves among surfaces: in sub-steps, with an exact distance at each.
//!
//! Both links are capsules and the camera is a ball. A sub-step is free if all three keep [`SKIN`] from every surface; the
//! arm stops at the last free one. No point moves more than a centimetre from one sub-step to the next, nor more than
//! the thinnest part's radius and skin: so no surface, however thin, is jumped over.
use super::motion::{closest_point, Motion, SceneShape, SKIN, STILL};
use crate::arm::{Arm, Posture};
use crate::capsule::{nearest_of_segments, Capsule};
use crate::error::{Error, Result};
use crate::geometry::Vec3;

/// Longest sub-step, metres.
pub const STEP: f32 = 0.01;
/// Room is told apart up to here, metres: after an answer the next is asked for when the arm has moved so far.
const FAR: f32 = 0.25;

/// The upper arm, the forearm, and the ball around the camera.
pub type Parts = [Capsule; 3];

/// The arm of one episode: where it stands and how it is held.
#[derive(Clone, Debug)]
pub struct StandingArm {
    arm: Arm,
    /// Radius of the ball around the camera.
    ball: f32,
    shoulder: Vec3,
    posture: Posture,
}

impl StandingArm {
    /// An arm with its hand at a point, or as near to it as it can be.
    pub fn new(arm: &Arm, ball: f32, shoulder: Vec3, hand: Vec3) -> Self {
        Self {
            posture: arm.posture(shoulder, hand),
            arm: arm.clone(),
            ball,
            shoulder,
        }
    }

    /// Shoulder (metres) and posture as six numbers.
    pub fn save(&self) -> [f32; 6] {
        let (s, p) = (self.shoulder, self.posture);
        [s.x, s.y, s.z, p.azimuth, p.pitch, p.radius]
    }

    /// An arm as it was saved; an error if it cannot be held so.
    pub fn load(arm: &Arm, ball: f32, state: [f32; 6]) -> Result<Self> {
        let [x, y, z, azimuth, pitch, radius] = state;
        let (nearest, farthest) = arm.reach();
        let fits = state.iter().all(|v| v.abs() <= 1e6)
            && azimuth.abs() <= 3.2
            && pitch.abs() <= 1.6
            && (nearest..=farthest).contains(&radius);
        if !fits {
            return Err(Error::invalid(format!(
                "an arm that reaches {nearest} to {farthest} m cannot be held as {state:?}"
            )));
        }
        Ok(Self {
            arm: arm.clone(),
            ball,
            shoulder: Vec3::new(x, y, z),
            posture: Posture {
                azimuth,
                pitch,
                radius,
            },
        })
    }

    pub fn parts(&self) -> Parts {
        self.parts_in(&self.posture)
    }

    fn parts_in(&self, posture: &Posture) -> Parts {
        let [upper, fore] = self.arm.links(self.shoulder, posture);
        [upper, fore, Capsule::ball(fore.b, self.ball)]
    }

    /// Moves the hand from `hand`, where it is, through the points of `path`, in spherical coordinates around the shoulder.
    /// The arm stops at the last sub-step that is free and that `passes` lets by: it is asked with the parts before and
    /// after a sub-step and the metres that the hand moves in it; no point moves more than `step` metres at once. A point out of reach is approached; one that is not
    /// finite ends the path.
    pub fn follow(
        &mut self,
        shape: &SceneShape,
        hand: Vec3,
        path: &[Vec3],
        step: f32,
        mut passes: impl FnMut(&Parts, &Parts, f32) -> bool,
    ) -> Motion {
        let mut motion = Motion {
            end: hand,
            travelled: 0.0,
            contact: false,
        };
        let mut parts = self.parts();
        let thinnest = self.ball.min(self.arm.link_radius);
        let step = step.min(thinnest + SKIN);
        // How far the arm can move before it can touch anything.
        let mut slack = 0.0;
        let arm = self.arm.clone();
        for &target in path {
            let length = target.distance(motion.end);
            if !length.is_finite() {
                break;
            }
            if length < STILL {
                continue;
            }
            let goal = arm.posture(self.shoulder, target);
            for posture in arm.swing(self.posture, goal, step) {
                let next = self.parts_in(&posture);
                let moved = next.iter().zip(&parts).map(|(n, p)| n.moved_from(p));
                slack -= moved.fold(0.0, f32::max);
                if slack < 0.0 {
                    slack = shape.slack(&next);
                }
                let free = slack >= 0.0 || shape.leads_away(&parts, &next);
                let metres = next[2].a.distance(parts[2].a);
                if !free || !passes(&parts, &next, metres) {
                    motion.contact = true;
                    return motion;
                }
                self.posture = posture;
                motion.travelled += metres;
                motion.end = next[2].a;
                parts = next;
            }
            if arm.reaches(self.shoulder, target) {
                // Without the rounding of the way there and back.
                motion.end = target;
            }
        }
        motion
    }
}

impl SceneShape {
    /// Metres between a capsule and the nearest surface, at most `max`; below zero where they overlap.
    pub fn room(&self, capsule: &Capsule, max: f32) -> f32 {
        let (a, b) = (capsule.a, capsule.b);
        let mut nearest = max + capsule.radius;
        if let Some(ground) = self.ground {
            nearest = nearest.min((a.z.min(b.z) - ground).max(0.0));
        }
        if let Some(mesh) = &self.mesh {
            let (low, high) = (a.min(b), a.max(b));
            let found = mesh.bvh().find_best(
                nearest,
                |node, _| {
                    let apart = (node.mins() - high).max(low - node.maxs());
                    apart.max(Vec3::ZERO).length()
                },
                |triangle, _| {
                    let corners =
                        mesh.indices()[triangle as usize].map(|i| mesh.vertices()[i as usize]);
                    Some(distance_to_triangle(a, b, corners))
                },
            );
            if let Some((_, distance)) = found {
                nearest = nearest.min(distance);
            }
        }
        nearest - capsule.radius
    }

    /// Metres that the parts can move until one of them comes within [`SKIN`] of a surface; below zero if one is.
    fn slack(&self, parts: &[Capsule]) -> f32 {
        let room = parts.iter().map(|p| self.room(p, FAR));
        room.fold(FAR, f32::min) - SKIN
    }

    /// Whether an arm has room so.
    pub fn has_room(&self, arm: &Arm, ball: f32, shoulder: Vec3, hand: Vec3) -> bool {
        arm.reaches(shoulder, hand)
            && self.slack(&StandingArm::new(arm, ball, shoulder, hand).parts()) >= 0.0
    }

    /// Whether no part that is too near to a surface comes nearer to it: whoever is in touch may go away.
    fn leads_away(&self, before: &Parts, after: &Parts) -> bool {
        before.iter().zip(after).all(|(before, after)| {
            let then = self.room(after, FAR);
            then >= SKIN || then >= self.room(before, FAR)
        })
    }
}

/// Metres between the segment from `a` to `b` and a triangle.
fn distance_to_triangle(a: Vec3, b: Vec3, [p, q, r]: [Vec3; 3]) -> f32 {
    let to = |x: Vec3| closest_point(x, p, q, r).distance(x);
    let mut nearest = to(a).min(to(b));
    if a == b {
        return nearest;
    }
    for (from, to) in [(p, q), (q, r), (r, p)] {
        let (on, other) = nearest_of_segments(a, b, from, to);
        nearest = nearest.min(on.distance(other));
    }
    // Where the segment crosses the triangle's plane.
    let normal = (q - p).cross(r - p);
    let (over, under) = (normal.dot(a - p), normal.dot(b - p));
    if over * under < 0.0 {
        nearest = nearest.min(to(a + (b - a) * (over / (over - under))));
    }
    nearest
}

#[cfg(test)]
mod tests;
