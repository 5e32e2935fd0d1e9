//! Poses, boxes and meshes. SI units, world z up; camera x right, y down, z forward.
use crate::error::{Error, Result};
pub use glam::{IVec3, Mat3, Quat, UVec3, Vec2, Vec3};

/// A rigid transform. A variable of this type is named `target_from_source`, e.g. `world_from_camera`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    pub translation: Vec3,
    pub rotation: Quat,
}

impl Pose {
    pub const IDENTITY: Pose = Pose {
        translation: Vec3::ZERO,
        rotation: Quat::IDENTITY,
    };

    pub fn new(translation: Vec3, rotation: Quat) -> Self {
        Self {
            translation,
            rotation,
        }
    }

    /// From the seven numbers of a viewpoint, `tx ty tz qx qy qz qw`; the quaternion is normalised.
    pub fn from_array(v: [f32; 7]) -> Result<Self> {
        let norm = (v[3] * v[3] + v[4] * v[4] + v[5] * v[5] + v[6] * v[6]).sqrt();
        // The norm overflows long before its numbers do.
        if v.iter().any(|x| !x.is_finite())
            || !(1e-6..=1e18).contains(&norm)
            || v[..3].iter().any(|x| x.abs() > 1e6)
        {
            return Err(Error::invalid(format!(
                "viewpoint must be 7 finite numbers tx ty tz qx qy qz qw with a quaternion != 0 (|q| in 1e-6..1e18) and |t| <= 1e6 m, got {v:?}"
            )));
        }
        // An already normalised quaternion is kept bit for bit, so that a pose survives a round trip.
        let rotation = Quat::from_xyzw(v[3], v[4], v[5], v[6]);
        let rotation = if (norm - 1.0).abs() < 1e-6 {
            rotation
        } else {
            rotation * (1.0 / norm)
        };
        Ok(Self::new(Vec3::new(v[0], v[1], v[2]), rotation))
    }

    pub fn to_array(self) -> [f32; 7] {
        let (t, q) = (self.translation, self.rotation);
        [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
    }

    /// The camera pose at `eye` whose optical axis (z) goes to `target` and whose x axis is horizontal.
    /// Looking straight up or down, the image's "up" is world +x.
    pub fn looking_at(eye: Vec3, target: Vec3) -> Self {
        let forward = (target - eye).normalize_or(Vec3::X);
        let right = forward.cross(Vec3::Z);
        let right = if right.length() < 1e-4 {
            Vec3::NEG_Y * forward.z.signum() * -1.0
        } else {
            right.normalize()
        };
        let down = forward.cross(right);
        Self::new(
            eye,
            Quat::from_mat3(&Mat3::from_cols(right, down, forward)).normalize(),
        )
    }

    /// The camera pose at `eye` with heading `yaw` (0 = world +x, counter-clockwise) and `pitch` (up positive), radians.
    pub fn from_yaw_pitch(eye: Vec3, yaw: f32, pitch: f32) -> Self {
        let (sy, cy) = yaw.sin_cos();
        let (sp, cp) = pitch.sin_cos();
        let forward = Vec3::new(cy * cp, sy * cp, sp);
        let right = Vec3::new(sy, -cy, 0.0);
        let down = forward.cross(right);
        Self::new(
            eye,
            Quat::from_mat3(&Mat3::from_cols(right, down, forward)).normalize(),
        )
    }

    /// Heading of the optical axis in the world's xy plane, radians.
    pub fn yaw(&self) -> f32 {
        let f = self.rotation * Vec3::Z;
        f.y.atan2(f.x)
    }

    pub fn point(&self, p: Vec3) -> Vec3 {
        self.rotation * p + self.translation
    }

    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self::new(-(rotation * self.translation), rotation)
    }

    pub fn compose(&self, other: &Pose) -> Self {
        Self::new(
            self.point(other.translation),
            self.rotation * other.rotation,
        )
    }

    /// Angle between two orientations, radians.
    pub fn angle_to(&self, other: &Pose) -> f32 {
        2.0 * self
            .rotation
            .dot(other.rotation)
            .abs()
            .clamp(0.0, 1.0)
            .acos()
    }
}

/// An axis-aligned box in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    pub min: Vec3,
    pub max: Vec3,
}

impl Default for Aabb {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl Aabb {
    pub const EMPTY: Aabb = Aabb {
        min: Vec3::INFINITY,
        max: Vec3::NEG_INFINITY,
    };

    pub fn new(min: Vec3, max: Vec3) -> Self {
        Self { min, max }
    }

    pub fn of(points: impl IntoIterator<Item = Vec3>) -> Self {
        points
            .into_iter()
            .fold(Self::EMPTY, |b, p| Self::new(b.min.min(p), b.max.max(p)))
    }

    pub fn union(&self, other: &Aabb) -> Self {
        Self::new(self.min.min(other.min), self.max.max(other.max))
    }

    pub fn grown(&self, margin: f32) -> Self {
        Self::new(self.min - margin, self.max + margin)
    }

    pub fn contains(&self, p: Vec3) -> bool {
        p.cmpge(self.min).all() && p.cmple(self.max).all()
    }

    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    pub fn size(&self) -> Vec3 {
        self.max - self.min
    }

    pub fn center(&self) -> Vec3 {
        (self.min + self.max) * 0.5
    }
}

/// A triangle soup with shared vertices, in metres and in the world frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    pub vertices: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    pub fn bounds(&self) -> Aabb {
        Aabb::of(self.vertices.iter().copied())
    }

    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|i| self.vertices[i as usize])
    }

    pub fn append(&mut self, other: &Mesh) {
        let base = self.vertices.len() as u32;
        self.vertices.extend_from_slice(&other.vertices);
        self.triangles
            .extend(other.triangles.iter().map(|t| t.map(|i| i + base)));
    }
}
