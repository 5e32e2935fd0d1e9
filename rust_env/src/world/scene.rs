//! A static scene: what cameras see, what bodies hit, and what the loader had to say about it.
use crate::geometry::{Aabb, Mesh, Vec3};
use crate::world::bodies::Walker;
use xxhash_rust::xxh3::Xxh3;

#[derive(Clone, Debug, Default)]
pub struct Scene {
    pub name: String,
    /// What cameras see. Duplicate and degenerate triangles are already dropped. Cast double-sided.
    pub visual: Mesh,
    /// The object of each visual triangle, counted from 1; 0: the shell (floor, walls, ceiling) and the ground plane. For
    /// generated scenes a piece of furniture or a thing on it, for worlds a placed model, for a lone mesh a connected part.
    pub objects: Vec<u32>,
    /// What bodies hit *besides* `visual` (bodies hit the union), cleaned in the same way.
    pub collision: Mesh,
    /// Height of an infinite ground plane, if the scene has one (also present in `visual` as a finite square).
    pub ground_plane: Option<f32>,
    /// Height of the floor that a robot stands on.
    pub floor: f32,
    /// Where exploration takes place: the bounds without the ground plane.
    pub bounds: Aabb,
    /// Known free camera positions with a heading (radians); may be empty, then `placement` looks for some.
    pub starts: Vec<(Vec3, f32)>,
    /// People that the file tells of; they are no part of the meshes. A setup says whether they walk.
    pub actors: Vec<Walker>,
    pub report: LoadReport,
}

impl Scene {
    /// A digest (XXH3) of everything that decides what happens in the scene: not of its name or of what the loader said.
    pub fn digest(&self) -> u64 {
        let mut hash = Xxh3::new();
        let mut vector = |v: &Vec3| {
            v.to_array()
                .iter()
                .for_each(|x| hash.update(&x.to_le_bytes()))
        };
        for mesh in [&self.visual, &self.collision] {
            mesh.vertices.iter().for_each(&mut vector);
            vector(&Vec3::NAN);
        }
        vector(&self.bounds.min);
        vector(&self.bounds.max);
        for (position, yaw) in &self.starts {
            vector(position);
            vector(&Vec3::splat(*yaw));
        }
        let plane = self.ground_plane.unwrap_or(f32::NAN);
        vector(&Vec3::new(plane, self.floor, 0.0));
        for triangle in self
            .visual
            .triangles
            .iter()
            .chain(&self.collision.triangles)
        {
            triangle.iter().for_each(|i| hash.update(&i.to_le_bytes()));
        }
        hash.digest()
    }
}

/// What reading a scene found; `nbv-gym scenes info` prints it.
#[derive(Clone, Debug, Default)]
pub struct LoadReport {
    /// Triangles as read, before duplicates and degenerate ones were dropped.
    pub visual_triangles_read: usize,
    pub collision_triangles_read: usize,
    /// Number of placed models or objects.
    pub instances: usize,
    /// Sorted, human-readable, each naming file and element.
    pub warnings: Vec<String>,
    /// URIs of models or meshes that were not found.
    pub missing: Vec<String>,
    pub visual_bounds: Aabb,
    pub collision_bounds: Aabb,
    pub load_milliseconds: f64,
    /// What the cache on disk had to do with it: empty for a scene that is none of its business.
    pub cache: String,
}
