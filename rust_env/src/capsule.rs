//! Capsules: what bodies are made of. A ball is one whose axis is a point.
use crate::geometry::Vec3;

/// What lies within `radius` metres of the segment from `a` to `b`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    pub a: Vec3,
    pub b: Vec3,
    pub radius: f32,
}

impl Capsule {
    pub fn new(a: Vec3, b: Vec3, radius: f32) -> Self {
        Self { a, b, radius }
    }

    pub fn ball(center: Vec3, radius: f32) -> Self {
        Self::new(center, center, radius)
    }

    /// The point of the axis nearest to `p`.
    pub fn axis_near(&self, p: Vec3) -> Vec3 {
        if self.a == self.b {
            return self.a;
        }
        let along = self.b - self.a;
        let t = (p - self.a).dot(along) / along.length_squared();
        self.a + along * t.clamp(0.0, 1.0)
    }

    /// Metres that no point of the capsule moves farther than, from `before` to here: its points are convex
    /// combinations of the ends.
    pub fn moved_from(&self, before: &Capsule) -> f32 {
        before.a.distance(self.a).max(before.b.distance(self.b))
    }
}

/// The points nearest to each other of the segments `p` to `q` and `r` to `s` (Ericson, Real-Time Collision Detection,
/// section 5.1.9).
pub fn nearest_of_segments(p: Vec3, q: Vec3, r: Vec3, s: Vec3) -> (Vec3, Vec3) {
    let (d, e, w) = (q - p, s - r, p - r);
    let (dd, ee, f) = (d.length_squared(), e.length_squared(), e.dot(w));
    let (t, u) = if dd == 0.0 && ee == 0.0 {
        (0.0, 0.0)
    } else if dd == 0.0 {
        (0.0, (f / ee).clamp(0.0, 1.0))
    } else {
        let c = d.dot(w);
        if ee == 0.0 {
            ((-c / dd).clamp(0.0, 1.0), 0.0)
        } else {
            let b = d.dot(e);
            let denominator = dd * ee - b * b;
            // Parallel segments: any point will do to begin with.
            let t = if denominator > 0.0 {
                ((b * f - c * ee) / denominator).clamp(0.0, 1.0)
            } else {
                0.0
            };
            let u = (b * t + f) / ee;
            if u < 0.0 {
                ((-c / dd).clamp(0.0, 1.0), 0.0)
            } else if u > 1.0 {
                (((b - c) / dd).clamp(0.0, 1.0), 1.0)
            } else {
                (t, u)
            }
        }
    };
    (p + d * t, r + e * u)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-2.0f32..2.0).prop_map(Vec3::from_array)
    }

    proptest! {
        #[test]
        fn segments_are_as_near_as_their_points(p in vector(), q in vector(), r in vector(), s in vector(), parallel in any::<bool>()) {
            let s = if parallel { r + (q - p) * 0.7 } else { s };
            let (on, other) = nearest_of_segments(p, q, r, s);
            let capsule = Capsule::new(p, q, 0.0);
            prop_assert!(capsule.axis_near(on).distance(on) < 1e-5);
            prop_assert!(Capsule::new(r, s, 0.0).axis_near(other).distance(other) < 1e-5);
            let sampled = (0..=200)
                .map(|i| r.lerp(s, i as f32 / 200.0))
                .map(|x| capsule.axis_near(x).distance(x))
                .fold(f32::INFINITY, f32::min);
            let found = on.distance(other);
            prop_assert!(found <= sampled + 1e-4 && found >= sampled - 0.03, "{found} {sampled}");
        }

        #[test]
        fn points_near_a_segment(p in vector(), q in vector(), x in vector(), t in 0.0f32..1.0) {
            let found = Capsule::new(p, q, 0.0).axis_near(x).distance(x);
            prop_assert!(found <= p.lerp(q, t).distance(x) + 1e-5);
        }
    }

    #[test]
    fn points_are_segments_too() {
        let (p, q) = (Vec3::X, Vec3::new(1.0, 2.0, 0.0));
        assert_eq!(nearest_of_segments(p, p, q, q), (p, q));
        assert_eq!(
            nearest_of_segments(p, p, Vec3::ZERO, Vec3::ZERO + Vec3::Y),
            (p, Vec3::ZERO)
        );
        assert_eq!(
            nearest_of_segments(Vec3::NEG_Y, Vec3::Y, p, p),
            (Vec3::ZERO, p)
        );
        assert_eq!(Capsule::ball(p, 0.1).axis_near(q), p);
        let moved = Capsule::new(p, q, 0.1).moved_from(&Capsule::new(p, p, 0.1));
        assert_eq!(moved, 2.0);
    }
}
