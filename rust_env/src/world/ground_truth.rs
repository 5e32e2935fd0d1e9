//! Which surface voxels there are, and which of them sight can reach: what coverage is measured against.
mod sight;
mod voxels;

pub use sight::Sight;
pub use voxels::VoxelSet;
pub(super) use voxels::{floor, voxels_of};

use super::bytes::{Fault, Reader, Writer};
use super::render::DepthRenderer;
use crate::camera::Camera;
use crate::error::Result;
use crate::geometry::{Aabb, IVec3, Mesh};

/// The surface voxels that count, on the map's lattice: those that sight can reach, or that images showed.
pub struct GroundTruth {
    visible: VoxelSet,
    count: u64,
}

impl GroundTruth {
    /// `range` is the longest ray that the map takes in, metres; `camera` gives the frustum of fixed views.
    pub fn new(
        mesh: &Mesh,
        renderer: &DepthRenderer,
        bounds: &Aabb,
        resolution: f64,
        range: f32,
        camera: &Camera,
        sight: &Sight,
    ) -> Result<Self> {
        let surface = voxels::Surface::new(mesh, bounds, resolution)?;
        let visible = sight::visible(
            &surface,
            mesh,
            renderer,
            range.min(camera.far),
            camera,
            sight,
        )?;
        Ok(Self {
            count: visible.len(),
            visible,
        })
    }

    /// The surface voxels among those of a map; `map` gives the words of a brick of 8 x 8 x 8 voxels.
    pub fn within(
        mesh: &Mesh,
        bounds: &Aabb,
        resolution: f64,
        map: impl Fn(IVec3) -> [u64; 8],
    ) -> Result<Self> {
        let mut visible = VoxelSet::surface(mesh, bounds, resolution)?;
        visible.intersect(map);
        Ok(Self {
            count: visible.len(),
            visible,
        })
    }

    pub fn write(&self, out: &mut Writer) {
        self.visible.write(out);
    }

    /// What [`GroundTruth::write`] wrote.
    pub fn read(from: &mut Reader) -> std::result::Result<Self, Fault> {
        let visible = VoxelSet::read(from)?;
        Ok(Self {
            count: visible.len(),
            visible,
        })
    }

    /// The words of a brick of 8 x 8 x 8 voxels; `None` outside the bounds.
    pub fn words(&self, brick: IVec3) -> Option<&[u64; 8]> {
        self.visible.words(brick)
    }

    /// Number of voxels.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Keys in a fixed order.
    pub fn keys(&self) -> Vec<IVec3> {
        self.visible.keys()
    }
}
