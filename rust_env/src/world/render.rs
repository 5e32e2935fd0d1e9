//! What a camera sees: rays against a bounding volume hierarchy of the visual triangles, double-sided.
use crate::camera::{Camera, DepthKind};
use crate::geometry::{Mesh, Pose, Vec3};
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::bvh2::Bvh2;
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;
use obvhs::BvhBuildParams;

/// A triangle as the intersection test wants it: a corner and two edges.
#[derive(Clone, Copy)]
struct Edges {
    corner: Vec3,
    edge1: Vec3,
    edge2: Vec3,
}

impl Edges {
    /// Distance along the ray to the triangle, from either side (Möller & Trumbore 1997).
    #[inline]
    fn hit(&self, origin: Vec3, direction: Vec3) -> f32 {
        let p = direction.cross(self.edge2);
        let determinant = self.edge1.dot(p);
        let inverse = 1.0 / determinant;
        let s = origin - self.corner;
        let u = s.dot(p) * inverse;
        let q = s.cross(self.edge1);
        let v = direction.dot(q) * inverse;
        let t = self.edge2.dot(q) * inverse;
        // Comparisons with NaN (a degenerate triangle) are false: no hit.
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 {
            t
        } else {
            f32::INFINITY
        }
    }
}

/// Renders depth images; immutable, shared by all environments that use a scene.
pub struct DepthRenderer {
    /// `None` for a mesh without triangles.
    bvh: Option<Bvh2>,
    /// In the order of the hierarchy's leaves.
    triangles: Vec<Edges>,
}

impl DepthRenderer {
    pub fn new(mesh: &Mesh) -> Self {
        // The builder uses another version of glam.
        let triangles: Vec<Triangle> = (0..mesh.triangles.len())
            .map(|i| mesh.corners(i))
            .filter(|c| c.iter().all(|p| p.is_finite()))
            .map(|c| c.map(|p| p.to_array()))
            .map(|[a, b, c]| Triangle { v0: a.into(), v1: b.into(), v2: c.into() })
            .collect();
        if triangles.is_empty() {
            return Self { bvh: None, triangles: Vec::new() };
        }
        let bvh = build_bvh2_from_tris(&triangles, BvhBuildParams::medium_build(), &mut Default::default());
        let in_leaf_order = bvh.primitive_indices.iter().map(|i| {
            let t = &triangles[*i as usize];
            let [corner, b, c] = [t.v0, t.v1, t.v2].map(|v| Vec3::from_array(v.to_array()));
            Edges { corner, edge1: b - corner, edge2: c - corner }
        });
        Self { triangles: in_leaf_order.collect(), bvh: Some(bvh) }
    }

    /// Distance to the first surface along a unit direction, if within `max_range`.
    #[inline]
    pub fn cast(&self, origin: Vec3, direction: Vec3, max_range: f32) -> Option<f32> {
        let bvh = self.bvh.as_ref()?;
        let ray = Ray::new(origin.to_array().into(), direction.to_array().into(), 0.0, max_range);
        let mut hit = RayHit::none();
        bvh.ray_traverse(ray, &mut hit, |_, i| self.triangles[i].hit(origin, direction));
        (hit.t <= max_range).then_some(hit.t)
    }

    /// A depth image, row by row; see [`crate::camera`] for its values.
    pub fn render(&self, camera: &Camera, world_from_camera: &Pose, out: &mut [f32]) {
        for v in 0..camera.height {
            for u in 0..camera.width {
                let ray = camera.ray(u, v);
                let length = ray.length();
                let direction = world_from_camera.rotation * (ray / length);
                // A depth is a range or a share of it; `far` and `near` are of the same kind.
                let share = match camera.kind {
                    DepthKind::Range => 1.0,
                    DepthKind::Z => 1.0 / length,
                };
                let range = self.cast(world_from_camera.translation, direction, camera.far / share);
                out[v * camera.width + u] = match range {
                    Some(r) if r * share < camera.near => 0.0,
                    Some(r) => r * share,
                    None => f32::INFINITY,
                };
            }
        }
    }

    pub fn memory_bytes(&self) -> usize {
        let nodes = self.bvh.as_ref().map_or(0, |b| b.nodes.len() * 32 + b.primitive_indices.len() * 4);
        nodes + self.triangles.len() * std::mem::size_of::<Edges>()
    }
}
