//! How uncertain a measurement of a point is, by where the camera sees it (Lluvia, Lazkano & Ansuategi 2023, Eq. 2-8).
use crate::camera::Camera;
use crate::geometry::Vec3;

/// Uncertainty of a measured point: small near the focal distance and near the optical axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UncertaintyModel {
    /// Distance at which the sensor measures best, metres (D_F).
    pub focal_distance: f32,
    /// Half of the horizontal and of the vertical field of view, radians.
    pub half_hfov: f32,
    pub half_vfov: f32,
}

/// Eq. 2 alone, for points of which no camera is known: both distances in metres.
#[inline(always)]
pub fn of_distance(distance: f32, focal_distance: f32) -> f32 {
    1.0 - 2.0 / (1.0 + exp((distance - focal_distance).abs()))
}

/// e^x for x >= 0, as if x were at most 88: relative error below 2e-7, the same bits on every machine, and without a branch,
/// so that a loop over many values vectorises (range reduction and polynomial of Cephes' `expf`, Moshier 1989).
#[inline(always)]
fn exp(x: f32) -> f32 {
    const LOG2_HIGH: f32 = 0.693_359_4;
    const LOG2_LOW: f32 = -2.121_944_4e-4;
    let x = if x < 88.0 { x } else { 88.0 };
    let power = (x * std::f32::consts::LOG2_E + 0.5) as i32;
    let n = power as f32;
    let r = x - n * LOG2_HIGH - n * LOG2_LOW;
    let mut p = 1.987_569_1e-4;
    for c in [1.398_2e-3, 8.333_452e-3, 4.166_579_6e-2, 0.166_666_65, 0.5] {
        p = p * r + c;
    }
    (p * (r * r) + r + 1.0) * f32::from_bits(((power + 127) as u32) << 23)
}

impl UncertaintyModel {
    /// The paper's D_F, metres.
    pub const FOCAL_DISTANCE: f32 = 1.0;

    pub fn of_camera(camera: &Camera) -> Self {
        Self {
            focal_distance: Self::FOCAL_DISTANCE,
            half_hfov: camera.hfov() * 0.5,
            half_vfov: camera.vfov() * 0.5,
        }
    }

    /// Eq. 8: uncertainty in [0, 1] of a point in the camera's frame (x right, y down, z forward), metres.
    #[inline]
    pub fn of(&self, point_in_camera: Vec3) -> f32 {
        self.of_parts(self.of_angles(point_in_camera), point_in_camera.length())
    }

    /// Eq. 2: u_d in [0, 1] of a point `distance` metres away, `1 - 2 / (1 + e^d)` with d the distance to the focal plane.
    #[inline]
    pub fn of_distance(&self, distance: f32) -> f32 {
        of_distance(distance, self.focal_distance)
    }

    /// Eq. 3-7: u_a in [0, 1], the same along a pixel's ray; 0 on the optical axis, 1 in the image's corners. Points
    /// outside the field of view count as its edge.
    #[inline]
    pub fn of_angles(&self, p: Vec3) -> f32 {
        let horizontal = p.x.abs().atan2(p.z) / self.half_hfov;
        let vertical = p.y.abs().atan2(p.z) / self.half_vfov;
        (horizontal.min(1.0) + vertical.min(1.0)) * 0.5
    }

    /// Eq. 8 from u_a, e.g. a pixel's value in [`Self::angle_table`], and the distance, metres.
    #[inline]
    pub fn of_parts(&self, angles: f32, distance: f32) -> f32 {
        (self.of_distance(distance) + angles) * 0.5
    }

    /// u_a of every pixel, row-major (`camera.pixels()` values): a measurement of the pixel needs only Eq. 2 and 8 then.
    pub fn angle_table(&self, camera: &Camera) -> Vec<f32> {
        (0..camera.height)
            .flat_map(|v| (0..camera.width).map(move |u| (u, v)))
            .map(|(u, v)| self.of_angles(camera.ray(u, v)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::from_fov(48, 36, 1.03, 0.80, 0.0, 4.0).unwrap()
    }

    #[test]
    fn is_zero_at_the_focal_point_and_one_half_at_the_focal_distance_in_a_corner() {
        let model = UncertaintyModel::of_camera(&camera());
        assert_eq!(model.of(Vec3::Z), 0.0);
        // A corner of the image at 1 m: u_d = 0, both angles at the edge.
        let corner = Vec3::new(model.half_hfov.tan(), model.half_vfov.tan(), 1.0).normalize();
        assert!((model.of(corner) - 0.5).abs() < 1e-6);
        assert!(
            (model.of(-corner) - 0.5).abs() < 1e-6,
            "behind the camera counts as the edge"
        );
    }

    #[test]
    fn distance_part_is_tanh_of_half_the_distance_to_the_focal_plane() {
        let model = UncertaintyModel::of_camera(&camera());
        for i in 0..100 {
            let d = i as f32 * 0.05;
            let expected = ((d - 1.0).abs() / 2.0).tanh();
            assert!((model.of_distance(d) - expected).abs() < 1e-6);
        }
        // By hand: 3 m on the axis, d = 2: (1 - 2 / (1 + e^2)) / 2 = 0.761594 / 2.
        assert!((model.of(Vec3::Z * 3.0) - 0.380_797).abs() < 1e-6);
    }

    #[test]
    fn exponential_is_right_to_seven_digits() {
        for i in 0..88_000 {
            let x = i as f32 * 1e-3;
            let expected = f64::from(x).exp();
            assert!((f64::from(exp(x)) / expected - 1.0).abs() < 2e-7, "{x}");
        }
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(of_distance(1e9, 1.0), 1.0);
    }

    #[test]
    fn table_holds_the_angle_part_of_every_pixel_ray() {
        let camera = camera();
        let model = UncertaintyModel::of_camera(&camera);
        let table = model.angle_table(&camera);
        assert_eq!(table.len(), camera.pixels());
        for (u, v, d) in [(0, 0, 0.5f32), (47, 35, 2.0), (24, 18, 1.0), (10, 30, 3.7)] {
            let ray = camera.ray(u, v);
            let p = ray * (d / ray.length());
            assert!((model.of(p) - model.of_parts(table[v * camera.width + u], d)).abs() < 1e-6);
        }
    }
}
