//! Where an episode can begin and where a camera can get to: found in the truth, before the robot knows anything.
use super::motion::SceneShape;
use super::render::DepthRenderer;
use super::scene::Scene;
use crate::geometry::{Aabb, IVec3, Vec3};

/// Height of the camera above the floor, metres (Wang 2019: 1.25 m).
pub const HEIGHT: f32 = 1.25;
/// Room around a start, and distance between starts, metres.
const CLEARANCE: f32 = 0.4;
const APART: f32 = 1.0;
const MAX_STARTS: usize = 64;
/// Clearances are told apart up to here.
const MAX_CLEARANCE: f32 = 5.0;
/// Largest distance down to the floor.
const MAX_DROP: f32 = 2.0;
/// Horizontal rays that look for walls.
const RAYS: usize = 16;
/// Most lattice points that are looked at; larger scenes get a wider lattice.
const MAX_POINTS: f32 = 40_000.0;

/// Camera positions `height` above the scene's floor with a heading (radians): indoors, with [`CLEARANCE`] around,
/// the roomiest first, at least [`APART`]. Deterministic.
///
/// Indoors means a floor below and walls in at least three quarters of all directions: neither garden nor roof.
pub fn find_starts(
    scene: &Scene,
    shape: &SceneShape,
    renderer: &DepthRenderer,
    radius: f32,
    height: f32,
) -> Vec<(Vec3, f32)> {
    let bounds = scene.bounds;
    if bounds.is_empty() || !bounds.size().is_finite() {
        return Vec::new();
    }
    let size = bounds.size();
    let pitch = (size.x * size.y / MAX_POINTS).sqrt().max(0.25);
    let z = scene.floor + height;
    let mut found: Vec<(Vec3, f32)> = Vec::new();
    for j in 0..=(size.y / pitch) as usize {
        for i in 0..=(size.x / pitch) as usize {
            let p = Vec3::new(
                bounds.min.x + i as f32 * pitch,
                bounds.min.y + j as f32 * pitch,
                z,
            );
            let clearance = shape.clearance(p, MAX_CLEARANCE);
            if clearance >= CLEARANCE.max(radius) && is_indoors(p, scene, renderer) {
                found.push((p, clearance));
            }
        }
    }
    // A stable sort: equal ones stay in the order of the lattice.
    found.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut starts: Vec<(Vec3, f32)> = Vec::new();
    for (p, _) in found {
        if starts.iter().all(|(q, _)| q.distance(p) >= APART) {
            starts.push((p, widest_view(p, size.length(), renderer)));
            if starts.len() == MAX_STARTS {
                break;
            }
        }
    }
    starts
}

/// The start with the most room around: where a dome of views fits best. The first of equal ones.
pub fn dome_anchor(starts: &[(Vec3, f32)], shape: &SceneShape) -> Option<(Vec3, f32)> {
    let mut best: Option<((Vec3, f32), f32)> = None;
    for start in starts {
        let clearance = shape.clearance(start.0, MAX_CLEARANCE);
        if best.is_none_or(|(_, most)| clearance > most) {
            best = Some((*start, clearance));
        }
    }
    best.map(|(start, _)| start)
}

/// Positions on a lattice around `start` that a ball can float to within `bounds`, `start` first.
///
/// The lattice has a pitch of 0.3 m, more in large bounds so that it keeps to 60,000 points.
pub fn reachable_positions(
    shape: &SceneShape,
    bounds: &Aabb,
    start: Vec3,
    radius: f32,
) -> Vec<Vec3> {
    const MAX_CELLS: f32 = 60_000.0;
    let size = bounds.size();
    if !start.is_finite() || !size.is_finite() || !bounds.contains(start) {
        return vec![start];
    }
    let pitch = (size.x * size.y * size.z / MAX_CELLS).cbrt().max(0.3);
    let low = ((bounds.min - start) / pitch).ceil().as_ivec3();
    let high = ((bounds.max - start) / pitch).floor().as_ivec3();
    let dims = high - low + 1;
    let index = |c: IVec3| {
        let d = c - low;
        ((d.z * dims.y + d.y) * dims.x + d.x) as usize
    };
    let position = |c: IVec3| start + c.as_vec3() * pitch;
    // Clearance by lattice point, as far as it matters here; asked for once.
    let mut clearances = vec![f32::NAN; (dims.x as usize) * (dims.y as usize) * (dims.z as usize)];
    let mut seen = vec![false; clearances.len()];
    let mut clearance = |c: IVec3| {
        let known = &mut clearances[index(c)];
        if known.is_nan() {
            *known = shape.clearance(position(c), radius + pitch);
        }
        *known
    };
    let mut found = vec![IVec3::ZERO];
    seen[index(IVec3::ZERO)] = true;
    let mut next = 0;
    while next < found.len() {
        let from = found[next];
        next += 1;
        // With a pitch of room around, no neighbour can be cut off.
        let roomy = clearance(from) >= radius + pitch;
        for step in [
            IVec3::X,
            IVec3::Y,
            IVec3::Z,
            IVec3::NEG_X,
            IVec3::NEG_Y,
            IVec3::NEG_Z,
        ] {
            let to = from + step;
            if to.cmplt(low).any()
                || to.cmpgt(high).any()
                || seen[index(to)]
                || clearance(to) <= radius
            {
                continue;
            }
            if roomy || shape.sweep(position(from), step.as_vec3(), pitch, radius) >= pitch {
                seen[index(to)] = true;
                found.push(to);
            }
        }
    }
    found.into_iter().map(position).collect()
}

fn heading(k: usize) -> f32 {
    k as f32 * std::f32::consts::TAU / RAYS as f32
}

fn horizontal(angle: f32) -> Vec3 {
    Vec3::new(angle.cos(), angle.sin(), 0.0)
}

fn is_indoors(p: Vec3, scene: &Scene, renderer: &DepthRenderer) -> bool {
    let on_ground = scene
        .ground_plane
        .is_some_and(|g| p.z > g && p.z - g <= MAX_DROP);
    if !on_ground && renderer.cast(p, Vec3::NEG_Z, MAX_DROP).is_none() {
        return false;
    }
    let reach = scene.bounds.size().length();
    let walls = (0..RAYS).filter(|&k| renderer.cast(p, horizontal(heading(k)), reach).is_some());
    walls.count() * 4 >= RAYS * 3
}

/// The heading with the most free space within a quarter turn.
fn widest_view(p: Vec3, reach: f32, renderer: &DepthRenderer) -> f32 {
    let ranges: [f32; RAYS] = std::array::from_fn(|k| {
        renderer
            .cast(p, horizontal(heading(k)), reach)
            .unwrap_or(0.0)
    });
    let view = |k: usize| -> f32 { (0..5).map(|d| ranges[(k + d + RAYS - 2) % RAYS]).sum() };
    let best = (0..RAYS).fold(0, |best, k| if view(k) > view(best) { k } else { best });
    heading(best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Mesh;
    use crate::world::test_scenes::*;

    struct Fixture {
        scene: Scene,
        shape: SceneShape,
        renderer: DepthRenderer,
    }

    impl Fixture {
        fn new(mesh: Mesh, bounds: Aabb, ground_plane: Option<f32>) -> Self {
            let scene = Scene {
                visual: mesh,
                bounds,
                ground_plane,
                ..Scene::default()
            };
            Self {
                shape: SceneShape::new(&scene),
                renderer: DepthRenderer::new(&scene.visual),
                scene,
            }
        }
        fn starts(&self) -> Vec<(Vec3, f32)> {
            find_starts(&self.scene, &self.shape, &self.renderer, 0.2, HEIGHT)
        }
    }

    #[test]
    fn starts_are_indoors_apart_and_roomy() {
        // The room of 5 x 4 m in a garden: bounds and ground reach 4 m further.
        let room = room(0.2);
        let bounds = room.bounds();
        let f = Fixture::new(
            room,
            Aabb::new(bounds.min - 4.0, bounds.max + 4.0),
            Some(0.0),
        );
        let starts = f.starts();
        assert!(starts.len() >= 4, "{starts:?}");
        let mut last = f32::INFINITY;
        for (i, (p, yaw)) in starts.iter().enumerate() {
            assert!(bounds.contains(*p) && p.z == HEIGHT, "{p}");
            let clearance = f.shape.clearance(*p, 10.0);
            assert!(clearance >= 0.4 && clearance <= last + 1e-6);
            last = clearance;
            assert!(starts[..i].iter().all(|(q, _)| q.distance(*p) >= 1.0));
            assert!(f.renderer.cast(*p, horizontal(*yaw), 10.0).unwrap() > 1.0);
        }
        assert_eq!(starts, f.starts());
        assert_eq!(dome_anchor(&starts, &f.shape), Some(starts[0]));
        assert_eq!(dome_anchor(&[], &f.shape), None);
    }

    #[test]
    fn no_start_without_floor_walls_or_bounds() {
        let mesh = room(0.3);
        let bounds = mesh.bounds();
        assert!(Fixture::new(mesh.clone(), Aabb::EMPTY, None)
            .starts()
            .is_empty());
        assert!(Fixture::new(Mesh::default(), bounds, Some(0.0))
            .starts()
            .is_empty());
        // Two walls only.
        let mut open = Mesh::default();
        let mut r = random(1);
        sheet(
            &mut open,
            Vec3::ZERO,
            Vec3::X * 5.0,
            Vec3::Z * 2.6,
            0.5,
            0.0,
            &mut r,
        );
        sheet(
            &mut open,
            Vec3::ZERO,
            Vec3::Y * 4.0,
            Vec3::Z * 2.6,
            0.5,
            0.0,
            &mut r,
        );
        assert!(Fixture::new(open.clone(), bounds, Some(0.0))
            .starts()
            .is_empty());
        // Four walls without a floor.
        sheet(
            &mut open,
            Vec3::Y * 4.0,
            Vec3::X * 5.0,
            Vec3::Z * 2.6,
            0.5,
            0.0,
            &mut r,
        );
        sheet(
            &mut open,
            Vec3::X * 5.0,
            Vec3::Y * 4.0,
            Vec3::Z * 2.6,
            0.5,
            0.0,
            &mut r,
        );
        assert!(Fixture::new(open.clone(), bounds, None).starts().is_empty());
        assert!(!Fixture::new(open, bounds, Some(0.0)).starts().is_empty());
    }

    #[test]
    fn flood_stays_inside_and_goes_round_corners() {
        // A wall with a gap near y = 4 splits the room.
        let mut mesh = Mesh::default();
        let mut r = random(1);
        cuboid(
            &mut mesh,
            Vec3::ZERO,
            Vec3::new(6.0, 4.0, 2.6),
            1.0,
            0.0,
            &mut r,
        );
        let wall = |mesh: &mut Mesh, to: f32| {
            sheet(
                mesh,
                Vec3::X * 3.0,
                Vec3::Y * to,
                Vec3::Z * 2.6,
                1.0,
                0.0,
                &mut random(1),
            );
        };
        let bounds = mesh.bounds().grown(2.0);
        let start = Vec3::new(1.0, 1.0, 1.25);
        for (to, passes) in [(3.0, true), (3.9, false), (4.0, false)] {
            let mut mesh = mesh.clone();
            wall(&mut mesh, to);
            let f = Fixture::new(mesh, bounds, None);
            let found = reachable_positions(&f.shape, &bounds, start, 0.2);
            assert_eq!(found[0], start);
            assert!(found
                .iter()
                .all(|p| f.shape.is_free(*p, 0.2) && p.x > 0.0 && p.x < 6.0 && p.z > 0.0));
            assert_eq!(found.iter().any(|p| p.x > 3.0), passes, "wall to {to}");
            assert!(found.iter().any(|p| p.x < 3.0 && p.y > 3.4 && p.z > 2.0));
        }
        let f = Fixture::new(mesh, bounds, None);
        assert_eq!(
            reachable_positions(&f.shape, &bounds, Vec3::splat(100.0), 0.2),
            [Vec3::splat(100.0)]
        );
    }
}
