//! Doors of generated plans are either open or shut.
use super::draw::{Draw, Random};
use super::layout::Layout;
use super::walls::{fit_opening, hang_leaf, wall, Opening};
use crate::geometry::{Mesh, Vec3};
use crate::world::render::DepthRenderer;
use glam::Vec2;
use rand::SeedableRng;

/// No ray passes a closed door, and none passes an open one between leaf and jamb.
#[test]
fn leaves_leave_no_slits() {
    let [a, b] = [Vec2::new(4.0, 0.0), Vec2::ZERO];
    for seed in 0..60 {
        let random = &mut Random::seed_from_u64(seed);
        let mut opening = Opening::door(2.0, random);
        if seed % 3 == 0 {
            opening.ajar = 0.0;
        }
        let outline = vec![Vec2::new(0.0, -3.0), Vec2::new(4.0, -3.0), a, b];
        let mut layout = Layout::new(outline, 0.0, 2.5);
        let back = [a, b].map(|p| p + Vec2::Y * 0.12);
        let mut mesh = Mesh::default();
        wall(&mut mesh, [a, b], back, 0.0, 2.5, &[opening]);
        fit_opening(&mut layout, [a, b], &opening, random);
        hang_leaf(&mut layout, [a, b], &opening, random);
        assert_eq!(layout.instances, 1);
        mesh.append(&layout.mesh);
        let renderer = DepthRenderer::new(&mesh);
        let is_stopped = |from: Vec3, to: Vec3| {
            let along = to - from;
            renderer
                .cast(from, along.normalize(), along.length())
                .is_some()
        };
        if opening.ajar == 0.0 {
            for _ in 0..3000 {
                let mut point =
                    |y| Vec3::new(random.between(0.8, 3.2), y, random.between(0.3, 2.2));
                let (from, to) = (point(0.6), point(-0.6));
                assert!(is_stopped(from, to), "{seed}: {from} to {to}");
            }
            continue;
        }
        let leaf = layout.solid[0].footprint.center;
        let jambs = [-0.5, 0.5].map(|s| Vec2::new(2.0 + s * opening.width, 0.0));
        let off = |jamb: &Vec2| (jamb.distance(leaf) - opening.width / 2.0).abs();
        let hinge = if off(&jambs[0]) < off(&jambs[1]) {
            jambs[0]
        } else {
            jambs[1]
        };
        for beyond in [0.001, 0.004, 0.01, 0.02] {
            for z in [0.01, 0.7, 1.9] {
                let from = Vec3::new(2.0, 1.0, z);
                let corner = hinge.extend(z) - Vec3::Y * beyond;
                let to = from + (corner - from) * 1.2;
                assert!(is_stopped(from, to), "{seed}: {beyond} m, {opening:?}");
            }
        }
    }
}
