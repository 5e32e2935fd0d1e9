//! Expected gain of information by lower uncertainty (Lluvia, Lazkano & Ansuategi 2023, Eq. 10-13).
use super::rays::VoxelGain;
use super::window::{Window, OCCUPIED, UNIT, UNKNOWN};
use crate::belief::octree::Octree;
use crate::belief::uncertainty::UncertaintyModel;
use crate::geometry::Pose;

/// Each ray meets its first voxel that is not free: an occupied one gains max(0, u_old - u_new), an unknown one
/// 1 - u_new, as if it were occupied ("positive"). u_new is the uncertainty (Eq. 2-8) of the voxel's centre.
/// Summed over *distinct* voxels as in Eq. 13 (the authors' released code sums over rays). A voxel nearer than the
/// camera's `near` cannot be measured and gains 0.
pub struct Uncertainty<'a> {
    octree: &'a Octree,
    model: &'a UncertaintyModel,
    camera_from_world: Pose,
    near: f32,
}

impl<'a> Uncertainty<'a> {
    pub fn new(octree: &'a Octree, model: &'a UncertaintyModel, view: &Pose, near: f32) -> Self {
        Self {
            octree,
            model,
            camera_from_world: view.inverse(),
            near,
        }
    }
}

impl VoxelGain for Uncertainty<'_> {
    const COUNTED: u8 = OCCUPIED | UNKNOWN;
    const OPAQUE: u8 = OCCUPIED | UNKNOWN;

    fn of(&self, window: &Window, voxel: usize) -> u64 {
        let key = window.key(voxel);
        let point = self.camera_from_world.point(self.octree.center(key));
        if point.length() < self.near {
            return 0;
        }
        let old = match window.state[voxel] {
            OCCUPIED => self.octree.uncertainty(key),
            _ => 1.0,
        };
        (f64::from((old - self.model.of(point)).max(0.0)) * UNIT) as u64
    }
}
