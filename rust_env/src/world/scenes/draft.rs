//! A generated scene before it becomes a `Scene`: shell and rooms in the plan's own frame.
use super::draw::{Draw, Random};
use super::layout::Layout;
#[cfg(test)]
use crate::geometry::Vec3;
use crate::geometry::{Aabb, Mesh};
use crate::world::scene::{LoadReport, Scene};
use glam::Vec2;

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
            if is_new && room.is_clear(p, CAMERA_HEIGHT, CLEARANCE) {
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

    /// The heading, out of 24, around which one looks farthest into the plan.
    fn open_heading(&self, p: Vec2, random: &mut Random) -> f32 {
        const COUNT: usize = 24;
        let first = random.heading();
        let yaw = |i: usize| first + std::f32::consts::TAU * i as f32 / COUNT as f32;
        let inside = |q: Vec2| self.rooms.iter().any(|r| r.is_clear(q, 1.0, 0.02));
        let free: Vec<usize> = (0..COUNT)
            .map(|i| {
                let step = Vec2::from_angle(yaw(i)) * 0.25;
                (1..20)
                    .find(|k| !inside(p + step * *k as f32))
                    .unwrap_or(20)
            })
            .collect();
        // The sum over a view of about 75 degrees.
        let seen = |i: &usize| -> usize { (0..5).map(|k| free[(i + COUNT + k - 2) % COUNT]).sum() };
        yaw((0..COUNT).max_by_key(seen).unwrap_or(0))
    }

    /// Turns the plan (one of three by any angle), shifts it off the voxel lattice and hands over a clean scene.
    pub fn finish(mut self, name: String, random: &mut Random) -> Scene {
        let mut visual = std::mem::take(&mut self.shell);
        let mut objects = vec![0; visual.triangles.len()];
        let mut before = 0;
        for room in &self.rooms {
            visual.append(&room.mesh);
            objects.extend(room.objects.iter().map(|number| number + before));
            before += room.instances as u32;
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
        let (visual, objects) = clean(visual, objects);
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
            objects,
            ..Scene::default()
        }
    }
}

/// Drops degenerate triangles and all but the first of equal ones, and their numbers; the order stays.
fn clean(mut mesh: Mesh, mut objects: Vec<u32>) -> (Mesh, Vec<u32>) {
    // Open addressing: the slots hold half of a triangle's hash and the number of a kept triangle + 1.
    let mask = (2 * mesh.triangles.len()).next_power_of_two() - 1;
    let mut slots = vec![0u64; mask + 1];
    let vertices = &mesh.vertices;
    let bits = |i: u32| vertices[i as usize].to_array().map(f32::to_bits);
    let corners = |t: &[u32; 3]| {
        let mut c = t.map(bits);
        c.sort_unstable();
        c
    };
    let mixed = |h: u64| (h ^ (h >> 32)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let hashes: Vec<u64> = (0..vertices.len() as u32)
        .map(|i| {
            let [x, y, z] = bits(i).map(u64::from);
            mixed(mixed(x << 32 | y).wrapping_add(z))
        })
        .collect();
    let mut kept: Vec<[u32; 3]> = Vec::with_capacity(mesh.triangles.len());
    for (i, t) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = [t[0], t[1], t[2]].map(|i| vertices[i as usize]);
        if (b - a).cross(c - a).length() <= 1e-9 {
            continue;
        }
        // A sum, as the corners' order does not matter.
        let sum = t
            .iter()
            .fold(0u64, |h, i| h.wrapping_add(hashes[*i as usize]));
        let hash = mixed(sum);
        // The upper half is mixed better: it says where.
        let (mut slot, tag) = ((hash >> 32) as usize & mask, hash & 0xFFFF_FFFF);
        let is_equal =
            |slot: u64| slot >> 32 == tag && corners(&kept[slot as u32 as usize - 1]) == corners(t);
        while slots[slot] != 0 && !is_equal(slots[slot]) {
            slot = (slot + 1) & mask;
        }
        if slots[slot] == 0 {
            // Never ahead of what is read.
            objects[kept.len()] = objects[i];
            kept.push(*t);
            slots[slot] = tag << 32 | kept.len() as u64;
        }
    }
    objects.truncate(kept.len());
    mesh.triangles = kept;
    (mesh, objects)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clean_drops_degenerate_and_repeated_triangles() {
        let vertices = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::X * 2.0, Vec3::X];
        let triangles = vec![[0, 1, 2], [0, 1, 3], [2, 0, 4], [0, 2, 3], [0, 0, 1]];
        let mesh = Mesh {
            vertices,
            triangles,
        };
        let (mesh, objects) = clean(mesh, vec![5, 6, 7, 8, 9]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(objects, [5, 8]);
    }
}
