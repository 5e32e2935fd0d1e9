//! Which surface voxels can be seen: images find most of them, rays look for the rest.
mod eyes;
mod hidden;

use super::voxels::{Surface, VoxelSet};
use crate::camera::{Camera, DepthKind};
use crate::error::Result;
use crate::geometry::{IVec3, Mesh, Pose, Vec3};
use crate::interrupt;
use crate::world::render::DepthRenderer;
use eyes::{Cells, Eyes};
use hidden::{around, Hidden, PIECES};

/// From where a task may look.
pub enum Sight<'a> {
    /// Only these viewpoints, within the camera's frustum.
    Views(&'a [Pose]),
    /// Any orientation from these positions.
    Positions(&'a [Vec3]),
}

/// Pixels of all images of the first pass together.
const PIXELS: usize = 160_000;
/// Eyes tried for a voxel next to a visible one, and for one that is alone or among others tried in vain.
const EYES: usize = 16;
const FEW_EYES: usize = 3;
/// Neighbours tried in vain that make a voxel's chances poor.
const IN_VAIN: usize = 4;

/// The voxels of `surface` of which some eye sees a point within `range`. Every member was hit by a ray.
pub(super) fn visible(
    surface: &Surface,
    mesh: &Mesh,
    renderer: &DepthRenderer,
    range: f32,
    camera: &Camera,
    sight: &Sight,
) -> Result<VoxelSet> {
    let mut search = Search {
        visible: surface.voxels.cleared(),
        surface,
        renderer,
        range,
        fresh: Vec::new(),
    };
    match sight {
        Sight::Views(views) => search.images_of_views(views, camera)?,
        Sight::Positions(positions) => search.images_all_round(positions)?,
    }
    let eyes = Eyes::new(sight, camera, range);
    let hidden = Hidden::new(surface, &search.visible, &eyes);
    // Visible surfaces hang together: from each voxel found, its neighbours are tried next, first from the same eye.
    // What the images missed is seen from few eyes: only those found later are hints worth a second visit. Hidden
    // surfaces hang together too: where neighbours were tried in vain, few rays must do.
    let mut visited = vec![false; hidden.keys.len()];
    let mut in_vain = surface.voxels.cleared();
    let mut in_images = std::mem::take(&mut search.fresh);
    let mut next = 0;
    loop {
        interrupt::check()?;
        let found_later = search.fresh.pop();
        if let Some((key, eye)) = found_later.or_else(|| in_images.pop()) {
            hidden.for_neighbours(key, |i| {
                let again = std::mem::replace(&mut visited[i], true);
                if search.visible.contains(hidden.keys[i]) || (again && found_later.is_none()) {
                    return;
                }
                let points = hidden.points(i, mesh, surface.resolution);
                let hints = if found_later.is_some() {
                    points.len()
                } else {
                    PIECES.min(points.len())
                };
                if search.look_from(hidden.keys[i], &points[..hints], &eyes, eye) || again {
                    return;
                }
                let poor = around(hidden.keys[i])
                    .filter(|k| in_vain.contains(*k))
                    .take(IN_VAIN)
                    .count()
                    == IN_VAIN;
                if poor {
                    search.look_for(hidden.keys[i], &points, &eyes, FEW_EYES, 1);
                } else if !search.look_for(hidden.keys[i], &points, &eyes, EYES, 3) {
                    in_vain.insert(hidden.keys[i]);
                }
            });
            continue;
        }
        let Some(i) = (next..hidden.keys.len()).find(|&i| !visited[i]) else {
            return Ok(search.visible);
        };
        next = i + 1;
        let points = hidden.points(i, mesh, surface.resolution);
        search.look_for(hidden.keys[i], &points, &eyes, FEW_EYES, 1);
    }
}

struct Search<'a> {
    visible: VoxelSet,
    surface: &'a Surface,
    renderer: &'a DepthRenderer,
    range: f32,
    /// Voxels found since their neighbours were tried, and the eye that found them.
    fresh: Vec<(IVec3, usize)>,
}

impl Search<'_> {
    /// Takes in the voxels that a point of a surface belongs to.
    fn mark(&mut self, point: Vec3, eye: usize) {
        let (low, high) = self.surface.keys(point);
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                for x in low.x..=high.x {
                    let key = IVec3::new(x, y, z);
                    if self.surface.voxels.contains(key) && self.visible.insert(key) {
                        self.fresh.push((key, eye));
                    }
                }
            }
        }
    }

    fn image(&mut self, camera: &Camera, view: &Pose, eye: usize, depth: &mut Vec<f32>) {
        depth.resize(camera.pixels(), 0.0);
        self.renderer.render(camera, view, depth);
        for v in 0..camera.height {
            for u in 0..camera.width {
                let range = depth[v * camera.width + u];
                if range > 0.0 && range.is_finite() {
                    self.mark(camera.unproject(view, u, v, range), eye);
                }
            }
        }
    }

    /// Images of some of the views, evenly picked, with the camera's field of view and fewer pixels.
    fn images_of_views(&mut self, views: &[Pose], camera: &Camera) -> Result<()> {
        let shrink = (camera.pixels() as f32 / 4096.0).sqrt().max(1.0);
        let small = |side: usize| ((side as f32 / shrink) as usize).clamp(1, side);
        let (width, height) = (small(camera.width), small(camera.height));
        let (sx, sy) = (
            width as f32 / camera.width as f32,
            height as f32 / camera.height as f32,
        );
        let camera = Camera {
            width,
            height,
            fx: camera.fx * sx,
            fy: camera.fy * sy,
            cx: camera.cx * sx,
            cy: camera.cy * sy,
            near: 0.0,
            far: self.range,
            kind: DepthKind::Range,
        };
        let mut depth = Vec::new();
        for i in spread(views.len(), PIXELS / camera.pixels()) {
            interrupt::check()?;
            self.image(&camera, &views[i], i, &mut depth);
        }
        Ok(())
    }

    /// Six images from each of some positions.
    fn images_all_round(&mut self, positions: &[Vec3]) -> Result<()> {
        const SIDE: usize = 40;
        let camera = Camera {
            width: SIDE,
            height: SIDE,
            fx: SIDE as f32 / 2.0,
            fy: SIDE as f32 / 2.0,
            cx: SIDE as f32 / 2.0,
            cy: SIDE as f32 / 2.0,
            near: 0.0,
            far: self.range,
            kind: DepthKind::Range,
        };
        // One position a cell: the lattice is finer than sight needs.
        let cells = Cells::new(positions);
        let firsts: Vec<usize> = cells.starts.iter().map(|&s| cells.order[s]).collect();
        let mut depth = Vec::new();
        for i in spread(
            firsts.len(),
            (PIXELS / (6 * camera.pixels())).max(firsts.len() / 8),
        ) {
            interrupt::check()?;
            let eye = firsts[i];
            let from = positions[eye];
            for axis in [
                Vec3::X,
                Vec3::Y,
                Vec3::Z,
                Vec3::NEG_X,
                Vec3::NEG_Y,
                Vec3::NEG_Z,
            ] {
                self.image(
                    &camera,
                    &Pose::looking_at(from, from + axis),
                    eye,
                    &mut depth,
                );
            }
        }
        Ok(())
    }

    /// Looks for one voxel from an eye.
    fn look_from(&mut self, key: IVec3, points: &[Vec3], eyes: &Eyes, eye: usize) -> bool {
        points.iter().any(|point| self.sees(key, *point, eyes, eye))
    }

    /// Looks for one voxel from up to `many` eyes: each at the middle of the largest piece and at some other points.
    fn look_for(
        &mut self,
        key: IVec3,
        points: &[Vec3],
        eyes: &Eyes,
        many: usize,
        points_each: usize,
    ) -> bool {
        if points.is_empty() {
            return false;
        }
        let resolution = self.surface.resolution;
        let center = ((key.as_dvec3() + 0.5) * resolution).as_vec3();
        let mut found = [0; EYES];
        let count = eyes.find(center, resolution as f32, &mut found[..many]);
        for (rank, &eye) in found[..count].iter().enumerate() {
            for k in 0..points_each {
                let point = if k == 0 {
                    0
                } else {
                    rank * (points_each - 1) + k
                };
                if self.sees(key, points[point % points.len()], eyes, eye) {
                    return true;
                }
            }
        }
        false
    }

    /// Casts a ray from an eye to a point; whatever the ray meets is marked. True if `key` is visible now.
    fn sees(&mut self, key: IVec3, point: Vec3, eyes: &Eyes, eye: usize) -> bool {
        let origin = eyes.positions[eye];
        let Some(direction) = (point - origin).try_normalize() else {
            return false;
        };
        if !eyes.in_view(eye, point) {
            return false;
        }
        let Some(t) = self.renderer.cast(origin, direction, self.range) else {
            return false;
        };
        self.mark(origin + direction * t, eye);
        self.visible.contains(key)
    }
}

/// At most `count` of the numbers below `len`, evenly spread.
fn spread(len: usize, count: usize) -> impl Iterator<Item = usize> {
    let count = count.clamp(1, len.max(1)).min(len);
    (0..count).map(move |i| i * len / count)
}

#[cfg(test)]
mod tests;
