//! What every image kernel needs to know about a camera at a pose, and how its hits become depths.
use super::simd::Simd;
use crate::camera::{Camera, DepthKind};
use crate::geometry::{Pose, Vec3};
use glam::Affine3A;

/// A camera at a pose. A ray is `forward + x * right + y * down` with x = (u + 0.5 - cx) / fx, so that distances
/// along it are z-depths.
pub struct View<'a> {
    pub camera: &'a Camera,
    pub origin: Vec3,
    pub right: Vec3,
    pub down: Vec3,
    pub forward: Vec3,
}

impl<'a> View<'a> {
    pub fn new(camera: &'a Camera, world_from_camera: &Pose) -> Self {
        let turn = |v: Vec3| world_from_camera.rotation * v;
        Self {
            camera,
            origin: world_from_camera.translation,
            right: turn(Vec3::X),
            down: turn(Vec3::Y),
            forward: turn(Vec3::Z),
        }
    }

    /// The same rays in another frame, also a scaled one.
    pub fn seen_from(&self, there_from_here: &Affine3A) -> Self {
        let turn = |v: Vec3| there_from_here.transform_vector3(v);
        Self {
            camera: self.camera,
            origin: there_from_here.transform_point3(self.origin),
            right: turn(self.right),
            down: turn(self.down),
            forward: turn(self.forward),
        }
    }

    /// x of pixel column `u` (pixel centre: u + 0.5).
    #[inline(always)]
    pub fn x(&self, column: f32) -> f32 {
        (column - self.camera.cx) / self.camera.fx
    }

    #[inline(always)]
    pub fn y(&self, row: f32) -> f32 {
        (row - self.camera.cy) / self.camera.fy
    }

    /// Direction with z = 1 through image coordinates (not pixel numbers).
    #[inline(always)]
    pub fn direction(&self, column: f32, row: f32) -> Vec3 {
        self.forward + self.x(column) * self.right + self.y(row) * self.down
    }

    /// Image depth (range or z, 0 below near, +inf beyond far) of z-depths `z` on rays (x, y, 1).
    #[inline(always)]
    pub fn depth<S: Simd>(&self, s: S, z: S::F, x: S::F, y: S::F) -> S::F {
        let depth = match self.camera.kind {
            DepthKind::Z => z,
            DepthKind::Range => s.mul(z, self.length(s, x, y)),
        };
        let far = s.select(
            s.le(depth, s.splat(self.camera.far)),
            depth,
            s.splat(f32::INFINITY),
        );
        s.select(s.lt(far, s.splat(self.camera.near)), s.zero(), far)
    }

    /// A z-depth a little beyond `far` on each ray.
    #[inline(always)]
    pub fn limit<S: Simd>(&self, s: S, x: S::F, y: S::F) -> S::F {
        let far = s.splat(self.camera.far * (1.0 + 1e-5));
        match self.camera.kind {
            DepthKind::Z => far,
            DepthKind::Range => s.div(far, self.length(s, x, y)),
        }
    }

    #[inline(always)]
    fn length<S: Simd>(&self, s: S, x: S::F, y: S::F) -> S::F {
        s.sqrt(s.mul_add(x, x, s.mul_add(y, y, s.splat(1.0))))
    }
}
