//! What a depth image shows of a scene: how many voxels of its surface, how many objects.
use super::object_grid::ObjectGrid;
use super::render::DepthRenderer;
use super::scene::Scene;
use crate::camera::Camera;
use crate::geometry::{Pose, Vec3};
use glam::DVec3;

/// What one depth image shows of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Visible {
    /// Distinct surface voxels.
    pub voxels: usize,
    /// Distinct objects, the shell not among them.
    pub objects: usize,
}

/// Counts what is seen in a depth image of the static scene.
pub struct Inspection<'a> {
    scene: &'a Scene,
    renderer: &'a DepthRenderer,
    grid: &'a ObjectGrid,
    depth: Vec<f32>,
    voxels: Vec<[i64; 3]>,
    objects: Vec<u32>,
}

impl<'a> Inspection<'a> {
    pub fn new(scene: &'a Scene, renderer: &'a DepthRenderer, grid: &'a ObjectGrid) -> Self {
        Self {
            scene,
            renderer,
            grid,
            depth: Vec::new(),
            voxels: Vec::new(),
            objects: Vec::new(),
        }
    }

    /// The voxels (side `resolution`, metres, key = floor(coordinate / resolution)) and the objects in which the image's
    /// rays end.
    pub fn look(&mut self, camera: &Camera, pose: &Pose, resolution: f64) -> Visible {
        self.depth.resize(camera.pixels(), 0.0);
        self.renderer.render(camera, pose, &mut self.depth);
        self.voxels.clear();
        self.objects.clear();
        let mut last = None;
        for (i, depth) in self.depth.iter().enumerate() {
            // 0: nearer than `near`.
            if !depth.is_finite() || *depth <= 0.0 {
                continue;
            }
            let (u, v) = (i % camera.width, i / camera.width);
            let end = camera.unproject(pose, u, v, *depth);
            let voxel = voxel_of(end, resolution);
            // Neighbouring pixels often end in the same voxel.
            if self.voxels.last() != Some(&voxel) {
                self.voxels.push(voxel);
            }
            if let Some(object) = self.grid.object_at(self.scene, end, &mut last) {
                if object != 0 && self.objects.last() != Some(&object) {
                    self.objects.push(object);
                }
            }
        }
        Visible {
            voxels: distinct(&mut self.voxels),
            objects: distinct(&mut self.objects),
        }
    }
}

/// floor(coordinate / resolution), without a call of the C library's floor.
fn voxel_of(point: Vec3, resolution: f64) -> [i64; 3] {
    // Where doubles have no fractions left, i64 has room.
    let limit = DVec3::splat(1e15);
    let at = (point.as_dvec3() / resolution).clamp(-limit, limit);
    at.to_array().map(|x| {
        let truncated = x as i64;
        truncated - i64::from(x < truncated as f64)
    })
}

fn distinct<T: Ord>(items: &mut Vec<T>) -> usize {
    items.sort_unstable();
    items.dedup();
    items.len()
}
