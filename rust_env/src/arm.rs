//! The kinematics of an arm of two links that carries a camera.
//!
//! The shoulder stands fixed, the hand is the camera's centre. The arm lies in the vertical plane through both, the elbow
//! above the line between them. In this plane the triangle of the two links and the line from shoulder to hand gives the
//! elbow in closed form: with links a (upper arm) and f (forearm) and the hand at distance r, the upper arm is raised
//! above the line by acos((a^2 + r^2 - f^2) / (2 a r)).
use crate::capsule::Capsule;
use crate::error::{positive, Error, Result};
use crate::geometry::Vec3;
use std::f32::consts::{PI, TAU};

/// Slack for rounding in what is in reach, metres.
const ROUNDING: f32 = 1e-4;
/// Longest link, metres: a way of the arm takes the more steps the longer it is.
const MAX_LINK: f64 = 10.0;

#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Length of the upper arm, shoulder to elbow, metres.
    pub upper_arm: f32,
    /// Length of the forearm, elbow to hand.
    pub forearm: f32,
    /// Radius of both links, which are capsules.
    pub link_radius: f32,
}

/// Where the hand is, seen from the shoulder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// Heading in the horizontal plane and angle above it, radians.
    pub azimuth: f32,
    pub pitch: f32,
    /// Distance, metres.
    pub radius: f32,
}

impl Arm {
    pub fn new(upper_arm: f64, forearm: f64, link_radius: f64) -> Result<Self> {
        for (name, metres) in [("upper_arm", upper_arm), ("forearm", forearm)] {
            if metres > MAX_LINK {
                return Err(Error::invalid(format!(
                    "robot {name} must be at most {MAX_LINK} m, got {metres}"
                )));
            }
        }
        Ok(Self {
            upper_arm: positive("robot upper_arm", upper_arm)? as f32,
            forearm: positive("robot forearm", forearm)? as f32,
            link_radius: positive("robot link_radius", link_radius)? as f32,
        })
    }

    /// Least and largest distance of the hand, metres.
    pub fn reach(&self) -> (f32, f32) {
        let (a, f) = (self.upper_arm, self.forearm);
        ((a - f).abs(), a + f)
    }

    /// Whether the hand can be at this point.
    pub fn reaches(&self, shoulder: Vec3, hand: Vec3) -> bool {
        let (nearest, farthest) = self.reach();
        let distance = hand.distance(shoulder);
        distance >= nearest - ROUNDING && distance <= farthest + ROUNDING
    }

    /// The posture with the hand at this point, or where the arm comes nearest to it.
    pub fn posture(&self, shoulder: Vec3, hand: Vec3) -> Posture {
        let (nearest, farthest) = self.reach();
        let from = hand - shoulder;
        Posture {
            azimuth: from.y.atan2(from.x),
            pitch: from.z.atan2(from.truncate().length()),
            radius: from.length().clamp(nearest, farthest),
        }
    }

    /// Elbow and hand.
    pub fn joints(&self, shoulder: Vec3, posture: &Posture) -> (Vec3, Vec3) {
        let (a, f, r) = (self.upper_arm, self.forearm, posture.radius);
        let cosine = (a * a + r * r - f * f) / (2.0 * a * r);
        // Links of equal length fold onto the shoulder: there any angle will do, here a quarter turn.
        let raised = if cosine.is_finite() { cosine } else { 0.0 };
        let raised = raised.clamp(-1.0, 1.0).acos();
        (
            shoulder + direction(posture.azimuth, posture.pitch + raised) * a,
            shoulder + direction(posture.azimuth, posture.pitch) * r,
        )
    }

    /// Upper arm and forearm.
    pub fn links(&self, shoulder: Vec3, posture: &Posture) -> [Capsule; 2] {
        let (elbow, hand) = self.joints(shoulder, posture);
        [
            Capsule::new(shoulder, elbow, self.link_radius),
            Capsule::new(elbow, hand, self.link_radius),
        ]
    }

    /// The way from one posture to another in spherical coordinates: azimuth the shorter way, pitch and radius linearly.
    /// No point of the arm moves more than `step` metres from one posture to the next; the first is `from` moved on, the
    /// last `to` itself.
    pub fn swing(&self, from: Posture, to: Posture, step: f32) -> Swing<'_> {
        Swing {
            arm: self,
            from,
            to,
            turn: half_turn(to.azimuth - from.azimuth),
            step,
            at: 0.0,
            last: 1.0,
        }
    }
}

/// The postures on the way from one to another; see [`Arm::swing`].
pub struct Swing<'a> {
    arm: &'a Arm,
    from: Posture,
    to: Posture,
    turn: f32,
    step: f32,
    /// Share of the way that lies behind, and of the last step.
    at: f32,
    last: f32,
}

impl Swing<'_> {
    fn posture(&self, t: f32) -> Posture {
        if t >= 1.0 {
            return self.to;
        }
        let mix = |a: f32, b: f32| a + (b - a) * t;
        Posture {
            azimuth: half_turn(self.from.azimuth + self.turn * t),
            pitch: mix(self.from.pitch, self.to.pitch),
            radius: mix(self.from.radius, self.to.radius),
        }
    }
}

impl Iterator for Swing<'_> {
    type Item = Posture;

    fn next(&mut self) -> Option<Posture> {
        if self.at >= 1.0 {
            return None;
        }
        let joints = |t: f32| self.arm.joints(Vec3::ZERO, &self.posture(t));
        let (elbow, hand) = joints(self.at);
        // Points of a link move no farther than its ends. Near the limits of reach the elbow moves much faster than the
        // hand, so that the step is found by trying. It cannot fall below rounding.
        let mut share = (2.0 * self.last).min(1.0 - self.at);
        for _ in 0..20 {
            let (e, h) = joints(self.at + share);
            if elbow.distance(e).max(hand.distance(h)) <= self.step {
                break;
            }
            share *= 0.5;
        }
        self.last = share.max(1e-6);
        self.at += self.last;
        if self.at > 1.0 - 1e-6 {
            self.at = 1.0;
        }
        Some(self.posture(self.at))
    }
}

/// The same angle within half a turn.
fn half_turn(angle: f32) -> f32 {
    (angle + PI).rem_euclid(TAU) - PI
}

fn direction(azimuth: f32, pitch: f32) -> Vec3 {
    let (sy, cy) = azimuth.sin_cos();
    let (sp, cp) = pitch.sin_cos();
    Vec3::new(cy * cp, sy * cp, sp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn arms() -> impl Strategy<Value = Arm> {
        (0.1f64..1.0, 0.1f64..1.0).prop_map(|(a, f)| Arm::new(a, f, 0.05).unwrap())
    }

    fn postures(arm: &Arm, angles: [f32; 2], stretched: f32) -> Posture {
        let (nearest, farthest) = arm.reach();
        Posture {
            azimuth: angles[0],
            pitch: angles[1],
            radius: nearest + (farthest - nearest) * stretched,
        }
    }

    proptest! {
        #[test]
        fn joints_fit_the_links_and_lead_back(arm in arms(), azimuth in -3.1f32..3.1, pitch in -1.5f32..1.5, stretched in 0.001f32..0.999) {
            let shoulder = Vec3::new(1.0, -2.0, 1.25);
            let posture = postures(&arm, [azimuth, pitch], stretched);
            let (elbow, hand) = arm.joints(shoulder, &posture);
            prop_assert!((elbow.distance(shoulder) - arm.upper_arm).abs() < 1e-5);
            prop_assert!((elbow.distance(hand) - arm.forearm).abs() < 1e-4);
            prop_assert!(arm.reaches(shoulder, hand));
            // In the vertical plane of shoulder and hand, on the upper side of the line between them.
            let across = Vec3::new(-azimuth.sin(), azimuth.cos(), 0.0);
            prop_assert!((elbow - shoulder).dot(across).abs() < 1e-5);
            let up = direction(azimuth, pitch + std::f32::consts::FRAC_PI_2);
            prop_assert!((elbow - shoulder).dot(up) >= -1e-6);
            let back = arm.posture(shoulder, hand);
            let (elbow_back, hand_back) = arm.joints(shoulder, &back);
            prop_assert!(hand_back.distance(hand) < 1e-5);
            // The elbow is as well determined as rounding allows where the arm is stretched or folded.
            prop_assert!(elbow_back.distance(elbow) < 5e-3, "{}", elbow_back.distance(elbow));
            let links = arm.links(shoulder, &posture);
            prop_assert_eq!((links[0].a, links[0].b, links[1].a, links[1].b), (shoulder, elbow, elbow, hand));
        }

        #[test]
        fn a_swing_is_continuous_and_ends_where_it_should(
            arm in arms(), from in prop::array::uniform3(0.0f32..1.0), to in prop::array::uniform3(0.0f32..1.0)
        ) {
            let pick = |x: [f32; 3]| postures(&arm, [TAU * x[0] - PI, 3.0 * x[1] - 1.5], x[2]);
            let (from, to) = (pick(from), pick(to));
            let (mut elbow, mut hand) = arm.joints(Vec3::ZERO, &from);
            let (mut last, mut turned) = (from, 0.0);
            for posture in arm.swing(from, to, 0.01) {
                let (e, h) = arm.joints(Vec3::ZERO, &posture);
                // Rounding of the elbow at the limits of reach.
                prop_assert!(elbow.distance(e) <= 0.0101 + 1e-3 && hand.distance(h) <= 0.0101);
                turned += half_turn(posture.azimuth - last.azimuth).abs();
                (elbow, hand, last) = (e, h, posture);
            }
            prop_assert_eq!(last, to);
            prop_assert!(turned <= PI + 1e-3, "the longer way: {turned}");
        }
    }

    #[test]
    fn a_right_angle_by_hand() {
        // Links 3 and 4, the hand 5 away: the elbow 3 * 4 / 5 above the line, 3 * 3 / 5 along it.
        let arm = Arm::new(3.0, 4.0, 0.1).unwrap();
        let level = arm.posture(Vec3::ZERO, Vec3::X * 5.0);
        assert_eq!((level.azimuth, level.pitch, level.radius), (0.0, 0.0, 5.0));
        let (elbow, hand) = arm.joints(Vec3::ZERO, &level);
        assert!(
            elbow.distance(Vec3::new(1.8, 0.0, 2.4)) < 1e-5 && hand.distance(Vec3::X * 5.0) < 1e-5
        );
        assert_eq!(arm.reach(), (1.0, 7.0));
    }

    #[test]
    fn out_of_reach_it_comes_as_near_as_it_can() {
        let arm = Arm::new(0.5, 0.3, 0.05).unwrap();
        for (hand, expected) in [(2.0, 0.8), (0.05, 0.2), (0.5, 0.5)] {
            assert_eq!(
                arm.reaches(Vec3::ONE, Vec3::ONE + Vec3::Y * hand),
                hand == 0.5
            );
            let posture = arm.posture(Vec3::ONE, Vec3::ONE + Vec3::Y * hand);
            assert!((posture.radius - expected).abs() < 1e-6);
        }
        let folded = Arm::new(0.5, 0.5, 0.05).unwrap();
        let (elbow, hand) = folded.joints(Vec3::ZERO, &folded.posture(Vec3::ZERO, Vec3::ZERO));
        assert!(elbow.is_finite() && hand == Vec3::ZERO);
    }

    #[test]
    fn bad_links_are_named() {
        for (links, word) in [
            ([0.0, 0.4, 0.06], "upper_arm"),
            ([0.4, f64::NAN, 0.06], "forearm"),
            ([0.4, 0.4, -1.0], "link_radius"),
            ([11.0, 0.4, 0.06], "upper_arm"),
        ] {
            let error = Arm::new(links[0], links[1], links[2])
                .unwrap_err()
                .to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}
