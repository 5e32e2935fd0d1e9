//! The pinhole depth camera. A depth image holds the *range* in metres along each pixel's ray
//! (`DepthKind::Range`) or the z-depth (`DepthKind::Z`); `+inf` = nothing within `far`, `0` = nearer than `near`.
use crate::error::{positive, Error, Result};
use crate::geometry::{Pose, Vec3};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum DepthKind {
    #[default]
    Range,
    Z,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    pub width: usize,
    pub height: usize,
    /// Focal lengths and principal point in pixels; the centre of pixel (u, v) is (u + 0.5, v + 0.5).
    pub fx: f32,
    pub fy: f32,
    pub cx: f32,
    pub cy: f32,
    /// Metres, of the same kind (range or z) as the image.
    pub near: f32,
    pub far: f32,
    pub kind: DepthKind,
}

/// Largest image side; a 4096 x 4096 image of f32 is 64 MiB.
pub const MAX_SIDE: usize = 4096;

impl Camera {
    /// `hfov` and `vfov` are full angles in radians.
    pub fn from_fov(
        width: usize,
        height: usize,
        hfov: f64,
        vfov: f64,
        near: f64,
        far: f64,
    ) -> Result<Self> {
        for (name, side) in [("width", width), ("height", height)] {
            if side == 0 || side > MAX_SIDE {
                return Err(Error::invalid(format!(
                    "camera {name} must be 1..={MAX_SIDE} pixels, got {side}"
                )));
            }
        }
        for (name, fov) in [("hfov", hfov), ("vfov", vfov)] {
            if !(fov > 1e-3 && fov < 3.1) {
                return Err(Error::invalid(format!(
                    "camera {name} must lie in (0.001, 3.1) rad, got {fov}"
                )));
            }
        }
        positive("camera far", far)?;
        if !(near >= 0.0 && (near as f32) < far as f32) {
            return Err(Error::invalid(format!(
                "camera near must lie in [0, far = {far}), got {near}"
            )));
        }
        Ok(Self {
            width,
            height,
            fx: (width as f64 / 2.0 / (hfov / 2.0).tan()) as f32,
            fy: (height as f64 / 2.0 / (vfov / 2.0).tan()) as f32,
            cx: width as f32 / 2.0,
            cy: height as f32 / 2.0,
            near: near as f32,
            far: far as f32,
            kind: DepthKind::Range,
        })
    }

    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    pub fn hfov(&self) -> f32 {
        2.0 * (self.width as f32 / 2.0 / self.fx).atan()
    }

    pub fn vfov(&self) -> f32 {
        2.0 * (self.height as f32 / 2.0 / self.fy).atan()
    }

    /// Direction of the pixel's ray in the camera frame with z = 1 (not normalised).
    #[inline]
    pub fn ray(&self, u: usize, v: usize) -> Vec3 {
        Vec3::new(
            (u as f32 + 0.5 - self.cx) / self.fx,
            (v as f32 + 0.5 - self.cy) / self.fy,
            1.0,
        )
    }

    /// The world point of a pixel with a measured, finite depth.
    #[inline]
    pub fn unproject(&self, world_from_camera: &Pose, u: usize, v: usize, depth: f32) -> Vec3 {
        let ray = self.ray(u, v);
        let scale = match self.kind {
            DepthKind::Range => depth / ray.length(),
            DepthKind::Z => depth,
        };
        world_from_camera.point(ray * scale)
    }
}
