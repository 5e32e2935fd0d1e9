//! What sensors see of bodies: three meshes, made once, that are moved and scaled into place.
use super::{Bodies, PushedBox, Walker};
use crate::geometry::{Mesh, Pose, Quat, Vec3};
use crate::world::render::{Movable, Placed};
use glam::Affine3A;
use std::f32::consts::{FRAC_PI_2, PI, TAU};
use std::sync::OnceLock;

/// Sides of a person: the mesh lies within 1 % of the radius inside the capsule.
const SIDES: u32 = 24;
const RINGS: u32 = 6;

/// Of radius, or half a side, one.
struct Shapes {
    cube: Movable,
    /// The upper half of a sphere.
    dome: Movable,
    /// From z = -1 to 1.
    tube: Movable,
}

fn shapes() -> &'static Shapes {
    static SHAPES: OnceLock<Shapes> = OnceLock::new();
    SHAPES.get_or_init(|| Shapes {
        cube: Movable::new(cube()),
        dome: Movable::new(lathe((0..=RINGS).map(|j| {
            let (z, radius) = (FRAC_PI_2 * j as f32 / RINGS as f32).sin_cos();
            (radius, z)
        }))),
        // A little longer, so that no ray slips between it and the domes.
        tube: Movable::new(lathe([(1.0, -1.001), (1.0, 1.001)])),
    })
}

/// The surface that a line of (radius, z) makes when it turns around the z axis.
fn lathe(line: impl IntoIterator<Item = (f32, f32)>) -> Mesh {
    let mut mesh = Mesh::default();
    for (radius, z) in line {
        for i in 0..SIDES {
            let (sin, cos) = (TAU * i as f32 / SIDES as f32).sin_cos();
            mesh.vertices.push(Vec3::new(radius * cos, radius * sin, z));
        }
    }
    for ring in 1..mesh.vertices.len() as u32 / SIDES {
        let (low, high) = ((ring - 1) * SIDES, ring * SIDES);
        for i in 0..SIDES {
            let j = (i + 1) % SIDES;
            mesh.triangles
                .extend([[low + i, low + j, high + j], [low + i, high + j, high + i]]);
        }
    }
    mesh
}

fn cube() -> Mesh {
    let side = |k: u32, axis: u32| if k >> axis & 1 == 0 { -1.0 } else { 1.0 };
    let corner = |k| Vec3::new(side(k, 0), side(k, 1), side(k, 2));
    let mut mesh = Mesh {
        vertices: (0..8).map(corner).collect(),
        triangles: Vec::new(),
    };
    for axis in 0..3u32 {
        let (a, b) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
        for face in [0, 1 << axis] {
            mesh.triangles.push([face, face + a, face + a + b]);
            mesh.triangles.push([face, face + a + b, face + b]);
        }
    }
    mesh
}

impl Bodies {
    /// The meshes that sensors see, in place.
    pub fn parts(&self) -> impl Iterator<Item = Placed<'static>> + '_ {
        let walkers = self.walkers.iter().flat_map(walker_parts);
        walkers.chain(self.boxes.iter().map(box_part))
    }

    /// Feet of the walkers, upright, then centres of the boxes.
    pub fn poses(&self) -> Vec<Pose> {
        let walkers = self.walkers.iter();
        let walkers = walkers.map(|w| Pose::new(w.position(), Quat::IDENTITY));
        let boxes = self.boxes.iter().map(|b| Pose::new(b.position, b.rotation));
        walkers.chain(boxes).collect()
    }

    /// What [`Bodies::parts`] shows as one mesh in the world frame.
    pub fn mesh(&self) -> Mesh {
        let mut all = Mesh::default();
        for part in self.parts() {
            let place = |v: &Vec3| part.world_from_movable.transform_point3(*v);
            all.append(&Mesh {
                vertices: part.movable.mesh.vertices.iter().map(place).collect(),
                triangles: part.movable.mesh.triangles.clone(),
            });
        }
        all
    }
}

fn walker_parts(walker: &Walker) -> [Placed<'static>; 3] {
    let (shapes, feet, radius) = (shapes(), walker.position(), walker.radius);
    let half = (0.5 * walker.height - radius).max(1e-3);
    let place = |movable, scale, turn, z| Placed {
        movable,
        world_from_movable: Affine3A::from_scale_rotation_translation(
            scale,
            turn,
            feet + Vec3::Z * z,
        ),
    };
    let (round, upright) = (Vec3::splat(radius), Quat::IDENTITY);
    // Turned over, not mirrored.
    let over = Quat::from_rotation_x(PI);
    [
        place(&shapes.dome, round, over, radius),
        place(
            &shapes.tube,
            Vec3::new(radius, radius, half),
            upright,
            radius + half,
        ),
        place(&shapes.dome, round, upright, radius + 2.0 * half),
    ]
}

fn box_part(pushed: &PushedBox) -> Placed<'static> {
    Placed {
        movable: &shapes().cube,
        world_from_movable: Affine3A::from_scale_rotation_translation(
            0.5 * pushed.size,
            pushed.rotation,
            pushed.position,
        ),
    }
}
