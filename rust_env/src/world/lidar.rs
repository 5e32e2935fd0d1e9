//! The planar lidar: a full circle of ranges in the horizontal plane.
use crate::error::{positive, Error, Result};
use crate::geometry::{Pose, Vec3};
use rand::RngExt;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use std::f32::consts::TAU;

/// Most rays of a scan.
pub const MAX_RAYS: usize = 1 << 16;

/// A planar lidar that stays level whatever the camera's pitch, above or below the camera.
///
/// A scan holds ranges in metres: ray `i` has the bearing `2 pi i / rays` counter-clockwise from the camera's heading, seen
/// from above. `+inf`: nothing within `range`; `0`: nearer than `near`.
#[derive(Clone, Debug, PartialEq)]
pub struct Lidar {
    pub rays: usize,
    pub near: f32,
    pub range: f32,
    /// Height above the camera, metres; negative is below.
    pub mount: f32,
    /// Standard deviation of a range, metres.
    pub sigma: f32,
}

impl Lidar {
    pub fn new(rays: usize, near: f64, range: f64, mount: f64, sigma: f64) -> Result<Self> {
        if rays == 0 || rays > MAX_RAYS {
            return Err(Error::invalid(format!(
                "lidar rays must be 1..={MAX_RAYS}, got {rays}"
            )));
        }
        positive("lidar range", range)?;
        if !(0.0..range).contains(&near) {
            return Err(Error::invalid(format!(
                "lidar near must lie in [0, range = {range}), got {near}"
            )));
        }
        if !(-100.0..=100.0).contains(&mount) {
            return Err(Error::invalid(format!(
                "lidar mount must lie in [-100, 100] m, got {mount}"
            )));
        }
        if !(0.0..=10.0).contains(&sigma) {
            return Err(Error::invalid(format!(
                "lidar sigma must lie in [0, 10] m, got {sigma}"
            )));
        }
        Ok(Self {
            rays,
            near: near as f32,
            range: range as f32,
            mount: mount as f32,
            sigma: sigma as f32,
        })
    }

    /// Where the rays begin for a camera's pose, and the direction of each.
    pub fn rays(&self, camera: &Pose) -> (Vec3, impl Iterator<Item = Vec3>) {
        let (heading, step) = (camera.yaw(), TAU / self.rays as f32);
        let direction = move |i| {
            let (sin, cos) = (heading + step * i as f32).sin_cos();
            Vec3::new(cos, sin, 0.0)
        };
        (
            camera.translation + Vec3::Z * self.mount,
            (0..self.rays).map(direction),
        )
    }

    /// The measured range of a true one (`None`: nothing within `range`). Every ray draws a number, as in an image.
    pub fn measure(&self, truth: Option<f32>, rng: Option<&mut Pcg64Mcg>) -> f32 {
        let error = rng.map_or(0.0, |rng| rng.sample::<f32, _>(StandardNormal));
        let measured = truth.map_or(f32::INFINITY, |range| range + self.sigma * error);
        if measured > self.range {
            f32::INFINITY
        } else if measured > 0.0 && measured >= self.near {
            measured
        } else {
            0.0
        }
    }
}
