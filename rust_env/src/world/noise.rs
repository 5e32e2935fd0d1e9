//! What a real sensor does to a perfect measurement: errors of depth that grow with it, steps of disparity, drop-outs.
use crate::camera::{Camera, DepthKind};
use crate::error::{Error, Result};
use crate::geometry::Vec3;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::f32::consts::FRAC_PI_2;

/// Names of the presets.
pub const PRESETS: [&str; 2] = ["gaussian", "kinect_v1"];

/// The noise of a depth image. Laws are in the z-depth, whatever the image holds. In this order: what is lost is found in
/// the perfect image; then an axial error is added, then disparity is rounded; a depth beyond the camera's `far`
/// becomes `+inf`, one below `near` and a lost one `0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthNoise {
    /// sigma(z) = constant + growth * (z - nearest)^2 metres (Nguyen, Izadi and Lovell, "Modeling Kinect sensor noise for
    /// improved 3D reconstruction and tracking", 3DIMPVT 2012, section 3).
    pub constant: f32,
    pub growth: f32,
    pub nearest: f32,
    /// Disparity focal_baseline / z is rounded to multiples of this, pixels: steps of depth that grow with z^2
    /// (Khoshelham and Elberink, "Accuracy and resolution of Kinect depth data", Sensors 2012). 0: not rounded.
    pub disparity_step: f32,
    /// Focal length times baseline, pixels times metres.
    pub focal_baseline: f32,
    /// A surface seen at a larger angle to its normal gives no depth, radians; pi/2: every surface gives one.
    pub max_incidence: f32,
    /// Neighbours that no surface seen at less than this angle joins have a depth edge between them, and the farther one
    /// is lost, radians; pi/2: none is.
    pub edge_incidence: f32,
}

impl DepthNoise {
    /// A preset of [`PRESETS`]. `gaussian`: the axial error alone, as Nguyen et al. measured it at 10 to 60 degrees of
    /// incidence. `kinect_v1`: with steps of 1/8 pixel at 580 pixels and 75 mm, and losses beyond 80 degrees (the end of
    /// what Nguyen et al. measured) and at edges.
    pub fn preset(name: &str) -> Result<Self> {
        let gaussian = Self {
            constant: 0.0012,
            growth: 0.0019,
            nearest: 0.4,
            disparity_step: 0.0,
            focal_baseline: 580.0 * 0.075,
            max_incidence: FRAC_PI_2,
            edge_incidence: FRAC_PI_2,
        };
        match name {
            "gaussian" => Ok(gaussian),
            "kinect_v1" => Ok(Self {
                disparity_step: 0.125,
                max_incidence: 80f32.to_radians(),
                edge_incidence: 85f32.to_radians(),
                ..gaussian
            }),
            other => Err(Error::invalid(format!(
                "noise kind must be one of {PRESETS:?}, got {other:?}"
            ))),
        }
    }

    /// This value if all of it is in range.
    pub fn checked(self) -> Result<Self> {
        for (name, value, most) in [
            ("constant", self.constant, 10.0),
            ("growth", self.growth, 10.0),
            ("nearest", self.nearest, 1000.0),
            ("disparity_step", self.disparity_step, 1000.0),
        ] {
            if !(0.0..=most).contains(&value) {
                return Err(Error::invalid(format!(
                    "noise {name} must lie in [0, {most}], got {value}"
                )));
            }
        }
        if !(self.focal_baseline > 0.0 && self.focal_baseline <= 1e6) {
            return Err(Error::invalid(format!(
                "noise focal_baseline must lie in (0, 1e6] pixel metres, got {}",
                self.focal_baseline
            )));
        }
        for (name, angle) in [
            ("max_incidence", self.max_incidence),
            ("edge_incidence", self.edge_incidence),
        ] {
            // The half circle's f32 may be a rounding beyond pi / 2.
            if !(angle > 0.0 && angle <= FRAC_PI_2 + 1e-6) {
                return Err(Error::invalid(format!(
                    "noise {name} must lie in (0, pi/2] rad, got {angle}"
                )));
            }
        }
        Ok(self)
    }

    /// Standard deviation of the axial error at z-depth `z`, metres.
    pub fn sigma(&self, z: f32) -> f32 {
        let beyond = z - self.nearest;
        self.constant + self.growth * beyond * beyond
    }

    /// The z-depth that a disparity of whole steps stands for; +inf for disparity 0.
    fn rounded(&self, z: f32) -> f32 {
        if self.disparity_step == 0.0 {
            return z;
        }
        let steps = (self.focal_baseline / z / self.disparity_step).round();
        self.focal_baseline / (steps * self.disparity_step)
    }

    /// Turns a perfect image (row-major) into a measured one. Every pixel draws one number, measured or not, so that what
    /// one pixel sees does not change another's error. `perfect` is working space.
    ///
    /// # Panics
    /// If `image` does not have `camera.pixels()` values.
    pub fn apply(
        &self,
        camera: &Camera,
        image: &mut [f32],
        perfect: &mut Vec<f32>,
        rng: &mut Pcg64Mcg,
    ) {
        assert_eq!(image.len(), camera.pixels(), "size of the depth image");
        perfect.clear();
        perfect.extend_from_slice(image);
        let seen = Surface {
            camera,
            image: perfect,
        };
        let losses = self.max_incidence < FRAC_PI_2 || self.edge_incidence < FRAC_PI_2;
        for v in 0..camera.height {
            for u in 0..camera.width {
                let error: f32 = rng.sample(StandardNormal);
                let depth = &mut image[v * camera.width + u];
                if !(*depth > 0.0 && depth.is_finite()) {
                    continue;
                }
                if losses && self.loses(&seen, u, v) {
                    *depth = 0.0;
                    continue;
                }
                let scale = range_per_z(camera, u, v);
                let z = *depth / scale;
                let measured = self.rounded(z + self.sigma(z) * error) * scale;
                *depth = if measured > camera.far {
                    f32::INFINITY
                } else if measured > 0.0 && measured >= camera.near {
                    measured
                } else {
                    0.0
                };
            }
        }
    }

    /// Whether a measured pixel of the perfect image gives no depth.
    fn loses(&self, seen: &Surface, u: usize, v: usize) -> bool {
        let Some(here) = seen.point(u, v) else {
            return false;
        };
        let steepest = self.edge_incidence.min(FRAC_PI_2).sin();
        let around = seen.neighbours(u, v);
        // How much of the way from a neighbour goes along this pixel's ray.
        let along = |p: Vec3| (here - p).normalize_or_zero().dot(here.normalize());
        if around.iter().flatten().any(|p| along(*p) > steepest) {
            return self.edge_incidence < FRAC_PI_2;
        }
        if self.max_incidence >= FRAC_PI_2 {
            return false;
        }
        // A neighbour beyond an edge lies on another surface.
        let near = |p: Option<Vec3>| p.filter(|p| along(*p) > -steepest);
        let tangent = |a, b| Some(near(a).unwrap_or(here) - near(b).unwrap_or(here));
        let [left, right, above, below] = around;
        let (Some(across), Some(down)) = (tangent(right, left), tangent(below, above)) else {
            return false;
        };
        let normal = across.cross(down);
        // A pixel without neighbours has no normal.
        normal.length_squared() > 0.0
            && normal.normalize().dot(here.normalize()).abs() < self.max_incidence.cos()
    }
}

/// Range over z-depth on a pixel's ray if the image holds ranges, else 1.
fn range_per_z(camera: &Camera, u: usize, v: usize) -> f32 {
    match camera.kind {
        DepthKind::Range => camera.ray(u, v).length(),
        DepthKind::Z => 1.0,
    }
}

/// The points that a perfect image shows, in the camera's frame.
struct Surface<'a> {
    camera: &'a Camera,
    image: &'a [f32],
}

impl Surface<'_> {
    fn point(&self, u: usize, v: usize) -> Option<Vec3> {
        let depth = self.image[v * self.camera.width + u];
        let z = depth / range_per_z(self.camera, u, v);
        (depth > 0.0 && depth.is_finite()).then(|| self.camera.ray(u, v) * z)
    }

    /// Left, right, above, below.
    fn neighbours(&self, u: usize, v: usize) -> [Option<Vec3>; 4] {
        let (w, h) = (self.camera.width, self.camera.height);
        let at = |inside: bool, u: usize, v: usize| if inside { self.point(u, v) } else { None };
        [
            at(u > 0, u.wrapping_sub(1), v),
            at(u + 1 < w, u + 1, v),
            at(v > 0, u, v.wrapping_sub(1)),
            at(v + 1 < h, u, v + 1),
        ]
    }
}

/// Where the random numbers of measurements come from: each measurement has a stream of its own, numbered from the
/// episode's beginning, so that two numbers say all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Disturbance {
    pub seed: u64,
    /// Measurements taken so far.
    pub taken: u64,
}

impl Disturbance {
    pub fn new(seed: u64) -> Self {
        Self { seed, taken: 0 }
    }

    /// The stream of the next measurement.
    pub fn next_stream(&mut self) -> Pcg64Mcg {
        let number = self.taken.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        self.taken = self.taken.wrapping_add(1);
        Pcg64Mcg::seed_from_u64(self.seed.wrapping_add(number))
    }
}

#[cfg(test)]
mod tests;
