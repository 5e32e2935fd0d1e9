//! A generated scene before it becomes a `Scene`: shell and rooms in the plan's own frame.
use super::draw::{Draw, Random};
use super::layout::Layout;
use crate::geometry::{Aabb, Mesh, Vec3};
use crate::world::scene::{LoadReport, Scene};
use glam::Vec2;
use std::collections::HashSet;

/// Height of the starts above the floor, metres.
pub(super) const CAMERA_HEIGHT: f32 = 1.25;
/// Thickness of floors and ceilings, metres.
pub(super) const SLAB: f32 = 0.1;

#[derive(Clone, Debug, Default)]
pub(super) struct Draft {
    /// Floor, walls and ceiling.
    pub shell: Mesh,
    pub rooms: Vec<Layout>,
    pub floor: f32,
    /// Camera positions in the plan and their headings.
    pub starts: Vec<(Vec2, f32)>,
    /// Exploration bounds where they are not those of the mesh.
    pub bounds: Option<Aabb>,
    /// A fixed plan keeps its place and heading.
    pub fixed: bool,
}

impl Draft {
    /// Fills `starts`: the middle of the first free disc, then two more places with 0.4 m around them.
    pub fn find_starts(&mut self, random: &mut Random) {
        const CLEARANCE: f32 = 0.42;
        let Some(first) = self.rooms.iter().find_map(|r| r.clear.first()) else {
            return;
        };
        let mut points = vec![first.0];
        let weights: Vec<f32> = self
            .rooms
            .iter()
            .map(|r| super::footprint::area(&r.outline))
            .collect();
        for _ in 0..400 {
            if points.len() == 3 {
                break;
            }
            let room = &self.rooms[random.weighted(&weights)];
            let p = room.point(random);
            let is_new = points.iter().all(|q| q.distance(p) > 0.5);
            if is_new && room.clearance(p, CAMERA_HEIGHT) > CLEARANCE {
                points.push(p);
            }
        }
        // A crowded plan may have no second place: the free disc holds two more.
        let offset = Vec2::from_angle(random.heading()) * 0.3;
        while points.len() < 3 {
            let sign = if points.len() == 1 { 1.0 } else { -1.0 };
            points.push(first.0 + offset * sign);
        }
        self.starts = points
            .into_iter()
            .map(|p| (p, self.open_heading(p, random)))
            .collect();
    }

    /// The heading, out of twelve, that looks farthest into the plan.
    fn open_heading(&self, p: Vec2, random: &mut Random) -> f32 {
        let first = random.heading();
        let free = |yaw: f32| {
            let step = Vec2::from_angle(yaw) * 0.25;
            (1..24)
                .find(|i| {
                    let q = p + step * *i as f32;
                    !self.rooms.iter().any(|r| r.clearance(q, 1.0) > 0.02)
                })
                .unwrap_or(24)
        };
        (0..12)
            .map(|i| first + std::f32::consts::TAU * i as f32 / 12.0)
            .max_by_key(|yaw| free(*yaw))
            .unwrap_or(first)
    }

    /// Turns the plan (one of three by any angle), shifts it off the voxel lattice and hands over a clean scene.
    pub fn finish(mut self, name: String, random: &mut Random) -> Scene {
        let mut visual = std::mem::take(&mut self.shell);
        for room in &self.rooms {
            visual.append(&room.mesh);
        }
        let turned = random.chance(1.0 / 3.0);
        let yaw = if turned { random.heading() } else { 0.0 };
        let shift = Vec2::new(random.between(-0.5, 0.5), random.between(-0.5, 0.5));
        let (turn, shift) = if self.fixed {
            (Vec2::X, Vec2::ZERO)
        } else {
            (Vec2::from_angle(yaw), shift)
        };
        let place = |p: Vec2| turn.rotate(p) + shift;
        for v in &mut visual.vertices {
            *v = place(v.truncate()).extend(v.z);
        }
        let read = visual.triangles.len();
        let visual = clean(visual);
        let visual_bounds = visual.bounds();
        let camera = self.floor + CAMERA_HEIGHT;
        Scene {
            name,
            bounds: self.bounds.unwrap_or(visual_bounds),
            floor: self.floor,
            starts: self
                .starts
                .iter()
                .map(|(p, heading)| (place(*p).extend(camera), heading + turn.to_angle()))
                .collect(),
            report: LoadReport {
                visual_triangles_read: read,
                instances: self.rooms.iter().map(|r| r.instances).sum(),
                visual_bounds,
                ..LoadReport::default()
            },
            visual,
            ..Scene::default()
        }
    }
}

/// Drops degenerate triangles and all but the first of equal ones; the order stays.
fn clean(mesh: Mesh) -> Mesh {
    let mut seen = HashSet::with_capacity(mesh.triangles.len());
    let key = |v: Vec3| v.to_array().map(f32::to_bits);
    let mut triangles = Vec::with_capacity(mesh.triangles.len());
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.vertices[i as usize]);
        let mut corners = [a, b, c].map(key);
        corners.sort_unstable();
        if (b - a).cross(c - a).length() > 1e-9 && seen.insert(corners) {
            triangles.push(*t);
        }
    }
    Mesh {
        vertices: mesh.vertices,
        triangles,
    }
}
