//! Motion through a scene: a body is swept along its path and stops at the first contact (rapier's collision shapes).
use super::scene::Scene;
use crate::error::{Error, Result};
use crate::geometry::Vec3;
use rapier3d::parry::query::{cast_shapes, ShapeCastOptions};
use rapier3d::parry::shape::{Ball, TriMeshFlags};
use rapier3d::prelude::{Pose as Isometry, SharedShape};

/// Gap that stays between a body and what it touches, metres.
const SKIN: f32 = 1e-3;

/// What bodies hit in a scene: the union of visual and collision geometry, shared by all episodes in it.
#[derive(Clone)]
pub struct SceneShape {
    /// `None` for a scene without triangles.
    mesh: Option<SharedShape>,
    ground: Option<f32>,
}

/// How a motion went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    pub end: Vec3,
    /// Metres.
    pub travelled: f32,
    /// Something was hit before the end of the path.
    pub contact: bool,
}

impl SceneShape {
    pub fn new(scene: &Scene) -> Result<Self> {
        let mut solid = scene.visual.clone();
        solid.append(&scene.collision);
        let mesh = if solid.triangles.is_empty() {
            None
        } else {
            // No flags: scans are open and wound anyhow, both sides of a wall must stop a body.
            let shape = SharedShape::trimesh_with_flags(
                solid.vertices,
                solid.triangles,
                TriMeshFlags::empty(),
            );
            Some(shape.map_err(|e| {
                Error::invalid(format!("scene {:?}: no collision shape: {e}", scene.name))
            })?)
        };
        Ok(Self {
            mesh,
            ground: scene.ground_plane,
        })
    }

    /// Metres a ball can go from `from` along `step` before it touches something: a share of the step in [0, 1].
    fn sweep(&self, radius: f32, from: Vec3, step: Vec3) -> Option<f32> {
        let mut first: Option<f32> = None;
        if let Some(mesh) = &self.mesh {
            let options = ShapeCastOptions {
                max_time_of_impact: 1.0,
                target_distance: SKIN,
                // A body in slight touch may move away.
                stop_at_penetration: false,
                ..ShapeCastOptions::default()
            };
            let still = Isometry::IDENTITY;
            let moving = Isometry::from_translation(from);
            if let Ok(Some(hit)) = cast_shapes(
                &moving,
                step,
                &Ball::new(radius),
                &still,
                Vec3::ZERO,
                mesh.as_ref(),
                options,
            ) {
                first = Some(hit.time_of_impact.clamp(0.0, 1.0));
            }
        }
        if let Some(ground) = self.ground {
            let gap = from.z - radius - SKIN - ground;
            if step.z < -gap {
                let share = (gap.max(0.0) / -step.z).clamp(0.0, 1.0);
                first = Some(first.map_or(share, |f| f.min(share)));
            }
        }
        first
    }

    /// Move a ball along way-points until the end or the first contact.
    pub fn follow(&self, radius: f32, from: Vec3, path: &[Vec3]) -> Motion {
        let mut motion = Motion {
            end: from,
            travelled: 0.0,
            contact: false,
        };
        for target in path {
            let step = *target - motion.end;
            let length = step.length();
            if !(length > 1e-6) {
                continue;
            }
            let share = self.sweep(radius, motion.end, step);
            let part = share.unwrap_or(1.0);
            motion.end = if share.is_none() {
                *target
            } else {
                motion.end + step * part
            };
            motion.travelled += length * part;
            if share.is_some() {
                motion.contact = true;
                break;
            }
        }
        motion
    }

    /// Metres from a point to the nearest surface.
    pub fn clearance(&self, point: Vec3) -> f32 {
        let mesh = self
            .mesh
            .as_ref()
            .map_or(f32::INFINITY, |m| m.distance_to_local_point(point, false));
        self.ground.map_or(mesh, |g| mesh.min(point.z - g))
    }

    /// A ball there touches nothing.
    pub fn is_free(&self, point: Vec3, radius: f32) -> bool {
        self.clearance(point) > radius
    }
}
