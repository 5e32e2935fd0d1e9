//! How uncertain a measured point is (Lluvia, Lazkano & Ansuategi 2023, Eq. 2-8): least on the optical axis at the
//! focal plane, most at the image's edge and far from that plane.
use crate::camera::Camera;
use crate::geometry::Vec3;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UncertaintyModel {
    /// D_F, metres.
    pub focal_distance: f32,
    /// Half the field of view, radians.
    pub half_hfov: f32,
    pub half_vfov: f32,
}

impl Default for UncertaintyModel {
    /// The paper's camera: 59 x 46 degrees, D_F = 1 m.
    fn default() -> Self {
        Self {
            focal_distance: 1.0,
            half_hfov: 59f32.to_radians() / 2.0,
            half_vfov: 46f32.to_radians() / 2.0,
        }
    }
}

impl UncertaintyModel {
    pub fn of_camera(camera: &Camera) -> Self {
        Self { half_hfov: camera.hfov() / 2.0, half_vfov: camera.vfov() / 2.0, ..Self::default() }
    }

    /// Eq. 2: u_d = 1 - 2 / (1 + e^d) with d = | |p| - D_F |.
    #[inline]
    pub fn of_distance(&self, range: f32) -> f32 {
        let d = (range - self.focal_distance).abs();
        1.0 - 2.0 / (1.0 + d.exp())
    }

    /// Eq. 3-7: the mean of both angles to the optical axis, each in units of half the field of view, at most 1.
    #[inline]
    pub fn of_angle(&self, point: Vec3) -> f32 {
        let horizontal = (point.x / point.z).atan().abs() / self.half_hfov;
        let vertical = (point.y / point.z).atan().abs() / self.half_vfov;
        ((horizontal + vertical) / 2.0).min(1.0)
    }

    /// Eq. 8, of a point in the camera frame with z > 0.
    #[inline]
    pub fn of(&self, point: Vec3) -> f32 {
        (self.of_distance(point.length()) + self.of_angle(point)) / 2.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equals_the_paper_at_points_computed_by_hand() {
        let model = UncertaintyModel::default();
        // On the axis at the focal plane nothing is uncertain.
        assert_eq!(model.of(Vec3::new(0.0, 0.0, 1.0)), 0.0);
        // On the axis at 3 m: u_d = tanh(1), u_a = 0.
        assert!((model.of(Vec3::new(0.0, 0.0, 3.0)) - 1f32.tanh() / 2.0).abs() < 1e-6);
        // In the image's corner u_a = 1.
        let corner = Vec3::new(model.half_hfov.tan(), model.half_vfov.tan(), 1.0);
        assert!((model.of_angle(corner) - 1.0).abs() < 1e-6);
    }
}
