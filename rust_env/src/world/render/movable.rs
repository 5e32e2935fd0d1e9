//! Meshes that move among static ones: each is rendered from its own frame, over the image of the static mesh.
//!
//! Depths compose by their minimum: it is exact for ranges and z-depths, for `+inf` (nothing) and for `0` (nearer than
//! `near`), so that any way of making the static image will do.
use super::bvh::Bvh;
use super::packet::{Packets, Window};
use super::view::View;
use super::{ray, DepthRenderer, SCRATCH};
use crate::camera::Camera;
use crate::geometry::{Aabb, Mesh, Pose, Vec3};
use glam::Affine3A;

/// A mesh with a hierarchy in its own frame.
pub struct Movable {
    pub mesh: Mesh,
    bvh: Bvh,
    bounds: Aabb,
}

impl Movable {
    pub fn new(mesh: Mesh) -> Self {
        Self {
            bvh: Bvh::new(&mesh),
            bounds: mesh.bounds(),
            mesh,
        }
    }
}

/// A movable mesh and where it is. The transform may scale, but not mirror.
#[derive(Clone, Copy)]
pub struct Placed<'a> {
    pub movable: &'a Movable,
    pub world_from_movable: Affine3A,
}

impl DepthRenderer {
    /// Draws a moved mesh over an image that [`DepthRenderer::render`] made with the same camera and pose.
    ///
    /// # Panics
    /// If `image` does not have `camera.pixels()` values.
    pub fn render_over(
        &self,
        placed: &Placed,
        camera: &Camera,
        world_from_camera: &Pose,
        image: &mut [f32],
    ) {
        assert_eq!(image.len(), camera.pixels(), "size of the depth image");
        let movable_from_world = placed.world_from_movable.inverse();
        let view = &View::new(camera, world_from_camera).seen_from(&movable_from_world);
        let Some(window) = window(view, &placed.movable.bounds) else {
            return;
        };
        SCRATCH.with_borrow_mut(|scratch| {
            self.isa.run(Packets {
                bvh: &placed.movable.bvh,
                view,
                todo: &mut scratch.todo,
                window,
                over: true,
                out: image,
            });
        });
    }

    /// As [`DepthRenderer::cast`], for a moved mesh.
    pub fn cast_at(
        &self,
        placed: &Placed,
        origin: Vec3,
        direction: Vec3,
        max_range: f32,
    ) -> Option<f32> {
        let movable_from_world = placed.world_from_movable.inverse();
        SCRATCH.with_borrow_mut(|scratch| {
            self.isa.run(ray::Cast {
                bvh: &placed.movable.bvh,
                origin: movable_from_world.transform_point3(origin),
                // Not normalised: so distances are the world's.
                direction: movable_from_world.transform_vector3(direction),
                limit: max_range,
                todo: &mut scratch.todo,
            })
        })
    }
}

/// The pixels that a box may cover; none if it lies behind the camera, beside the image or beyond `far`.
fn window(view: &View, bounds: &Aabb) -> Option<Window> {
    let camera = view.camera;
    // A movable without triangles has nothing to show.
    if bounds.is_empty() {
        return None;
    }
    // The frame may scale, so lengths are measured along the camera's axes: p = x right + y down + z forward.
    let axes = glam::Mat3::from_cols(view.right, view.down, view.forward).inverse();
    let corners: [Vec3; 8] = std::array::from_fn(|k| {
        let pick = |axis: usize| {
            if k >> axis & 1 == 0 {
                bounds.min[axis]
            } else {
                bounds.max[axis]
            }
        };
        axes * (Vec3::new(pick(0), pick(1), pick(2)) - view.origin)
    });
    let nearest = corners.iter().fold(f32::INFINITY, |n, c| n.min(c.z));
    let farthest = corners.iter().fold(f32::NEG_INFINITY, |n, c| n.max(c.z));
    let whole = Window::of(camera);
    // A z-depth is never more than the range.
    if farthest <= 0.0 || nearest > camera.far * 1.001 {
        return None;
    }
    if nearest < 1e-3 {
        return Some(whole);
    }
    let image = Aabb::of(corners.iter().map(|c| {
        let (x, y) = (c.x / c.z, c.y / c.z);
        Vec3::new(x * camera.fx + camera.cx, y * camera.fy + camera.cy, 0.0)
    }));
    // A pixel more at each side is far more than rounding. Casts from negative numbers give 0.
    let (low, high) = (image.min - 1.0, image.max + 2.0);
    let window = Window {
        left: low.x as usize,
        top: low.y as usize,
        right: whole.right.min(high.x as usize),
        bottom: whole.bottom.min(high.y as usize),
    };
    (window.left < window.right && window.top < window.bottom).then_some(window)
}
