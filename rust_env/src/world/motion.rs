//! Bodies in rapier: the robot's ball is swept along a path and stops where it first touches something.
use crate::geometry::{Mesh, Vec3};
use crate::world::scene::Scene;
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::query::intersection_test;
use rapier3d::parry::shape::{HalfSpace, Shape, TriMesh};
use rapier3d::prelude::{
    ColliderBuilder, PhysicsWorld, RigidBodyBuilder, RigidBodyHandle, SharedShape,
};
use std::sync::Arc;

/// The gap that a stopped ball keeps, metres; contact counts from here.
pub const SKIN: f32 = 0.001;
/// Shorter motions are none.
pub const STILL: f32 = 1e-6;

/// What bodies hit: the union of a scene's visual and collision meshes and its ground plane. Built once for a scene
/// and shared by all episodes in it.
#[derive(Clone)]
pub struct SceneShape {
    pub(super) mesh: Option<Arc<TriMesh>>,
    pub(super) ground: Option<f32>,
}

impl SceneShape {
    pub fn new(scene: &Scene) -> Self {
        let mut union = scene.visual.clone();
        union.append(&scene.collision);
        Self {
            mesh: trimesh(&union).map(Arc::new),
            ground: scene.ground_plane.filter(|z| z.is_finite()),
        }
    }

    /// Distance in metres from `position` to the nearest surface, at most `max`; 0 below the ground plane.
    pub fn clearance(&self, position: Vec3, max: f32) -> f32 {
        let mut nearest = max;
        if !position.is_finite() {
            return 0.0;
        }
        if let Some(ground) = self.ground {
            nearest = nearest.min((position.z - ground).max(0.0));
        }
        if let Some(mesh) = &self.mesh {
            // parry's projection ignores its bound when it walks the tree; this walk does not.
            let found = mesh.bvh().find_best(
                nearest,
                |node, _| {
                    let outside = (node.mins() - position).max(position - node.maxs());
                    outside.max(Vec3::ZERO).length()
                },
                |triangle, _| {
                    let [a, b, c] =
                        mesh.indices()[triangle as usize].map(|i| mesh.vertices()[i as usize]);
                    Some((closest_point(position, a, b, c) - position).length())
                },
            );
            if let Some((_, distance)) = found {
                nearest = nearest.min(distance);
            }
        }
        nearest
    }

    /// How far a ball can go from `start` along the unit vector `direction`, at most `length`, before it comes within
    /// [`SKIN`] of a surface. A ball that is within it already may move along the surface and away from it.
    pub fn sweep(&self, start: Vec3, direction: Vec3, length: f32, radius: f32) -> f32 {
        let mut free = length;
        if let Some(ground) = self.ground {
            let sweep = Sweep {
                start,
                direction,
                length: free,
                radius,
            };
            free = sweep
                .contact(|p| Vec3::new(p.x, p.y, ground.min(p.z)))
                .unwrap_or(free);
        }
        if let Some(mesh) = &self.mesh {
            let sweep = Sweep {
                start,
                direction,
                length: free,
                radius,
            };
            let margin = Vec3::splat(radius + SKIN);
            let inverse = direction.recip();
            let found = mesh.bvh().find_best(
                free,
                |node, _| {
                    // Where the centre enters the node's box grown by the ball. NaN (0 * inf) misses a box that is only touched.
                    let low = (node.mins() - margin - start) * inverse;
                    let high = (node.maxs() + margin - start) * inverse;
                    let mut enter = 0.0f32;
                    let mut leave = f32::INFINITY;
                    for axis in 0..3 {
                        enter = enter.max(low[axis].min(high[axis]));
                        leave = leave.min(low[axis].max(high[axis]));
                    }
                    if enter <= leave {
                        enter
                    } else {
                        f32::MAX
                    }
                },
                |triangle, _| {
                    let [a, b, c] =
                        mesh.indices()[triangle as usize].map(|i| mesh.vertices()[i as usize]);
                    sweep.contact(|p| closest_point(p, a, b, c))
                },
            );
            if let Some((_, distance)) = found {
                free = free.min(distance);
            }
        }
        free
    }

    /// Whether a ball has room here.
    pub fn is_free(&self, position: Vec3, radius: f32) -> bool {
        self.clearance(position, radius + STILL) > radius
    }

    /// Whether a shape touches or intersects a surface; the ground plane does not count.
    pub fn meets(&self, shape: &dyn Shape, world_from_shape: &RapierPose) -> bool {
        self.mesh.as_ref().is_some_and(|mesh| {
            // A pair of shapes that parry does not know is an error; these it knows.
            intersection_test(&RapierPose::IDENTITY, &**mesh, world_from_shape, shape)
                .map_or(true, |found| found.intersecting)
        })
    }

    /// A rapier world that holds the scene's colliders and nothing else.
    pub fn world(&self) -> PhysicsWorld {
        let mut world = PhysicsWorld::new();
        world.gravity = Vec3::new(0.0, 0.0, -9.81);
        if let Some(mesh) = &self.mesh {
            // Sharing, not copying: a collider holds its shape by reference count.
            world.insert_collider(ColliderBuilder::new(SharedShape(mesh.clone())), None);
        }
        if let Some(ground) = self.ground {
            let plane = SharedShape::new(HalfSpace::new(Vec3::Z));
            world.insert_collider(
                ColliderBuilder::new(plane).translation(Vec3::Z * ground),
                None,
            );
        }
        world
    }

    pub fn memory_bytes(&self) -> usize {
        self.mesh.as_ref().map_or(0, |m| m.total_memory_size())
    }
}

/// The triangles that have an area, or `None` if there are none.
fn trimesh(mesh: &Mesh) -> Option<TriMesh> {
    let triangles: Vec<[u32; 3]> = mesh
        .triangles
        .iter()
        .copied()
        .filter(|t| {
            let corner = |i: u32| mesh.vertices.get(i as usize).copied().unwrap_or(Vec3::NAN);
            let [a, b, c] = t.map(corner);
            // False for NaN.
            (b - a).cross(c - a).length_squared() > 1e-20
        })
        .collect();
    // No flags: fixing internal edges loses contacts from the back of single-sheet walls.
    TriMesh::new(mesh.vertices.clone(), triangles).ok()
}

/// A ball's motion along a line.
struct Sweep {
    start: Vec3,
    direction: Vec3,
    length: f32,
    radius: f32,
}

impl Sweep {
    /// Where the ball must stop for a convex body, given by its point closest to a point.
    ///
    /// The body stops a ball that would come nearer than half the skin, and stops it at the skin: so rounding never
    /// blocks a motion along a surface.
    fn contact(&self, closest: impl Fn(Vec3) -> Vec3) -> Option<f32> {
        let first = (closest(self.start) - self.start).length();
        // Whoever starts too near may not come nearer still (by more than rounding).
        let limit = (self.radius + 0.5 * SKIN).min(first - 0.1 * SKIN);
        self.reaches(limit, &closest)?;
        if first <= self.radius + SKIN {
            return Some(0.0);
        }
        self.reaches(self.radius + SKIN, &closest)
    }

    /// Where the distance to the body first falls to `distance`.
    ///
    /// Along a line the distance to a convex body is a convex function, so that Newton's steps from the left never
    /// pass its root.
    fn reaches(&self, distance: f32, closest: &impl Fn(Vec3) -> Vec3) -> Option<f32> {
        let mut t = 0.0;
        for _ in 0..40 {
            let centre = self.start + self.direction * t;
            let from_body = centre - closest(centre);
            let now = from_body.length();
            if now <= distance + 1e-6 {
                return Some(t);
            }
            let slope = self.direction.dot(from_body) / now;
            if slope >= 0.0 {
                return None;
            }
            t -= (now - distance) / slope;
            if t >= self.length {
                return None;
            }
        }
        Some(t)
    }
}

/// How far a ball can go from `start` along the unit vector `direction`, at most `length`, before it comes within
/// [`SKIN`] of a convex body, given by its point closest to a point; as [`SceneShape::sweep`].
pub fn sweep_convex(
    start: Vec3,
    direction: Vec3,
    length: f32,
    radius: f32,
    closest: impl Fn(Vec3) -> Vec3,
) -> f32 {
    let sweep = Sweep {
        start,
        direction,
        length,
        radius,
    };
    sweep.contact(closest).unwrap_or(length)
}

/// The point of triangle a, b, c nearest to p (Ericson, Real-Time Collision Detection, section 5.1.5).
pub(super) fn closest_point(p: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Vec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let scale = 1.0 / (va + vb + vc);
    a + ab * (vb * scale) + ac * (vc * scale)
}

/// How far a body came along a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    pub end: Vec3,
    /// Metres along the path.
    pub travelled: f32,
    /// Whether something stopped the body before the path's end.
    pub contact: bool,
}

/// One episode's bodies: the robot as a kinematic ball among fixed colliders.
pub struct Physics {
    world: PhysicsWorld,
    robot: RigidBodyHandle,
    radius: f32,
    shape: SceneShape,
}

impl Physics {
    pub fn new(shape: &SceneShape, robot_radius: f32, position: Vec3) -> Self {
        let mut world = shape.world();
        let (robot, _) = world.insert(
            RigidBodyBuilder::kinematic_position_based().translation(position),
            ColliderBuilder::ball(robot_radius),
        );
        // Queries see only what the broad phase has met.
        world.detect_collisions(&(), &());
        Self {
            world,
            robot,
            radius: robot_radius,
            shape: shape.clone(),
        }
    }

    pub fn position(&self) -> Vec3 {
        self.world.bodies[self.robot].translation()
    }

    /// Sweeps the ball from where it is through the points of `path`; it stops at the first contact, [`SKIN`] away.
    /// A ball that touches something already can move along and away from it. A point that is not finite ends the path.
    pub fn follow(&mut self, path: &[Vec3]) -> Motion {
        let mut motion = Motion {
            end: self.position(),
            travelled: 0.0,
            contact: false,
        };
        for &target in path {
            let length = (target - motion.end).length();
            if !length.is_finite() {
                break;
            }
            if length < STILL {
                continue;
            }
            let direction = (target - motion.end) / length;
            let free = self.shape.sweep(motion.end, direction, length, self.radius);
            motion.travelled += free;
            if free < length {
                motion.end += (target - motion.end) * (free / length);
                motion.contact = true;
                break;
            }
            motion.end = target;
        }
        self.move_to(motion.end);
        motion
    }

    /// Puts the ball where a motion ended.
    pub fn move_to(&mut self, position: Vec3) {
        self.world.bodies[self.robot].set_next_kinematic_translation(position);
        self.world.step();
    }

    pub fn shape(&self) -> &SceneShape {
        &self.shape
    }

    pub fn is_free(&self, position: Vec3, radius: f32) -> bool {
        self.shape.is_free(position, radius)
    }

    pub fn clearance(&self, position: Vec3, max: f32) -> f32 {
        self.shape.clearance(position, max)
    }
}

impl Clone for Physics {
    /// Everything that decides the future; rapier's workspaces start fresh.
    fn clone(&self) -> Self {
        let mut world = PhysicsWorld::new();
        world.gravity = self.world.gravity;
        world.integration_parameters = self.world.integration_parameters;
        world.islands = self.world.islands.clone();
        world.broad_phase = self.world.broad_phase.clone();
        world.narrow_phase = self.world.narrow_phase.clone();
        world.bodies = self.world.bodies.clone();
        world.colliders = self.world.colliders.clone();
        Self {
            world,
            robot: self.robot,
            radius: self.radius,
            shape: self.shape.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::test_scenes::*;
    use proptest::prelude::*;

    fn scene_of(mesh: Mesh) -> Scene {
        Scene {
            bounds: mesh.bounds(),
            visual: mesh,
            ..Scene::default()
        }
    }

    fn wall_at_x2() -> Mesh {
        let mut mesh = Mesh::default();
        sheet(
            &mut mesh,
            Vec3::new(2.0, -5.0, -5.0),
            Vec3::Y * 10.0,
            Vec3::Z * 10.0,
            0.5,
            0.0,
            &mut random(1),
        );
        mesh
    }

    #[test]
    fn stops_at_a_wall_from_either_side() {
        let shape = SceneShape::new(&scene_of(wall_at_x2()));
        for (from, to, expected) in [(0.0, 5.0, 2.0 - 0.251), (4.0, -1.0, 2.0 + 0.251)] {
            let mut physics = Physics::new(&shape, 0.25, Vec3::X * from);
            let motion = physics.follow(&[Vec3::X * from, Vec3::X * to]);
            assert!(motion.contact);
            assert!(
                (motion.end - Vec3::X * expected).length() < 1e-4,
                "{motion:?}"
            );
            assert!((motion.travelled - (expected - from).abs()).abs() < 1e-4);
            assert_eq!(physics.position(), motion.end);
        }
    }

    #[test]
    fn moves_along_and_away_from_what_it_touches() {
        let shape = SceneShape::new(&scene_of(wall_at_x2()));
        let mut physics = Physics::new(&shape, 0.25, Vec3::ZERO);
        physics.follow(&[Vec3::X * 5.0]);
        for i in 0..40 {
            let side = if i % 2 == 0 { 1.0 } else { -1.0 };
            let target = physics.position() + Vec3::new(0.0, side * 0.7, 0.3 * side);
            let along = physics.follow(&[target]);
            assert!(!along.contact, "step {i}: {along:?}");
            let into = physics.follow(&[physics.position() + Vec3::X * 0.5]);
            assert!(into.contact && into.travelled < 0.002, "{into:?}");
        }
        let away = physics.follow(&[Vec3::X]);
        assert!(!away.contact && away.end == Vec3::X);
        // Slightly inside the wall: out, but not through.
        for depth in [0.0, 1e-4, 0.01, 0.1] {
            let start = Vec3::X * (1.75 + depth);
            let mut physics = Physics::new(&shape, 0.25, start);
            assert!(physics.follow(&[Vec3::X * 3.0]).travelled < 1e-3);
            let out = physics.follow(&[Vec3::X]);
            assert!(!out.contact, "{out:?}");
        }
    }

    #[test]
    fn ground_plane_and_empty_scene() {
        let mut scene = Scene::default();
        let mut free = Physics::new(&SceneShape::new(&scene), 0.2, Vec3::ZERO);
        assert_eq!(
            free.follow(&[Vec3::X, Vec3::new(1.0, 2.0, 0.0)]).travelled,
            3.0
        );
        assert_eq!(free.clearance(Vec3::ZERO, 5.0), 5.0);
        scene.ground_plane = Some(0.5);
        let mut above = Physics::new(&SceneShape::new(&scene), 0.2, Vec3::Z * 2.0);
        let motion = above.follow(&[Vec3::ZERO]);
        assert!(
            motion.contact && (motion.end.z - 0.701).abs() < 1e-4,
            "{motion:?}"
        );
        assert!(!above.follow(&[Vec3::new(3.0, 0.0, 0.701)]).contact);
        assert!((above.clearance(Vec3::Z, 5.0) - 0.5).abs() < 1e-6);
        assert!(!above.is_free(Vec3::Z, 0.6) && above.is_free(Vec3::Z, 0.4));
    }

    #[test]
    fn nonsense_paths_move_nothing() {
        let shape = SceneShape::new(&scene_of(soup(50, 1)));
        let mut physics = Physics::new(&shape, 0.1, Vec3::splat(5.0));
        for bad in [Vec3::NAN, Vec3::INFINITY, Vec3::splat(f32::MAX)] {
            let motion = physics.follow(&[bad]);
            assert_eq!(
                (motion.end, motion.travelled, motion.contact),
                (Vec3::splat(5.0), 0.0, false)
            );
        }
        assert_eq!(physics.follow(&[]).travelled, 0.0);
        assert_eq!(physics.clearance(Vec3::NAN, 1.0), 0.0);
    }

    #[test]
    fn a_clone_continues_alike() {
        let shape = SceneShape::new(&scene_of(room(0.3)));
        let mut physics = Physics::new(&shape, 0.2, Vec3::new(2.8, 1.8, 1.5));
        physics.follow(&[Vec3::new(1.5, 1.5, 1.2)]);
        let mut copy = physics.clone();
        for target in [[0.5, 0.5, 0.5], [4.0, 3.0, 1.0], [4.9, 0.1, 2.0]] {
            assert_eq!(
                physics.follow(&[target.into()]),
                copy.follow(&[target.into()])
            );
        }
    }

    #[test]
    fn clearance_is_the_exact_distance() {
        let mesh = soup(200, 5);
        let shape = SceneShape::new(&scene_of(mesh.clone()));
        let mut r = random(2);
        for _ in 0..500 {
            let p = within(&mut r, Vec3::splat(-3.0), Vec3::splat(3.0));
            // Sampling the triangles bounds the distance from above, as finely as the samples lie.
            let sampled = (0..mesh.triangles.len())
                .filter(|t| {
                    let [a, b, c] = mesh.corners(*t);
                    (b - a).cross(c - a).length_squared() > 1e-20
                })
                .flat_map(|t| {
                    let [a, b, c] = mesh.corners(t);
                    (0..=20).flat_map(move |i| (0..=20 - i).map(move |j| (a, b, c, i, j)))
                })
                .map(|(a, b, c, i, j)| {
                    (a + (b - a) * (i as f32 / 20.0) + (c - a) * (j as f32 / 20.0)).distance(p)
                })
                .fold(f32::INFINITY, f32::min);
            let got = shape.clearance(p, 100.0);
            assert!(
                got <= sampled + 1e-5 && got >= sampled - 0.2,
                "{got} {sampled}"
            );
            assert!((shape.clearance(p, 0.3) - got.min(0.3)).abs() < 1e-6);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        /// Whatever the path, the ball never comes nearer than its start was or its radius, and never jumps.
        #[test]
        fn never_enters_or_tunnels(seed in 0u64..1000, radius in 0.05f32..0.4) {
            let mut r = random(seed);
            let mesh = if seed % 2 == 0 { room(0.4) } else { soup(40, seed) };
            let shape = SceneShape::new(&scene_of(mesh));
            let start = (0..1000)
                .map(|_| within(&mut r, Vec3::splat(0.1), Vec3::new(4.5, 3.5, 2.5)))
                .find(|p| shape.is_free(*p, radius + 0.01));
            if let Some(start) = start {
                let mut physics = Physics::new(&shape, radius, start);
                for _ in 0..30 {
                    let from = physics.position();
                    let target = from + within(&mut r, Vec3::splat(-1.0), Vec3::splat(1.0));
                    let motion = physics.follow(&[target]);
                    prop_assert!(motion.end.is_finite());
                    prop_assert!((motion.end.distance(from) - motion.travelled).abs() < 1e-4);
                    prop_assert!(motion.contact || motion.end == target);
                    for i in 0..=50 {
                        let p = from.lerp(motion.end, i as f32 / 50.0);
                        prop_assert!(shape.clearance(p, 1.0) >= radius - 1e-4, "inside by {}", radius - shape.clearance(p, 1.0));
                    }
                    if motion.contact {
                        // Something must really be there.
                        let ahead = motion.end + (target - from).normalize() * 0.01;
                        prop_assert!(shape.clearance(ahead, 1.0) < radius + 0.005);
                    }
                }
            }
        }
    }

    #[test]
    fn is_cheap() {
        let shape = SceneShape::new(&scene_of(room(0.03)));
        let count = 2000;
        let begin = thread_seconds();
        let mut physics = Physics::new(&shape, 0.2, Vec3::new(2.8, 1.8, 1.5));
        for _ in 1..200 {
            physics = Physics::new(&shape, 0.2, Vec3::new(2.8, 1.8, 1.5));
        }
        let new = (thread_seconds() - begin) / 200.0 * 1e6;
        let mut r = random(1);
        let mut contacts = 0;
        let begin = thread_seconds();
        for _ in 0..count {
            let target = physics.position() + within(&mut r, Vec3::splat(-0.3), Vec3::splat(0.3));
            contacts += usize::from(physics.follow(&[target]).contact);
        }
        let step = (thread_seconds() - begin) / f64::from(count) * 1e6;
        let begin = thread_seconds();
        for _ in 0..count {
            std::hint::black_box(physics.clone());
        }
        let clone = (thread_seconds() - begin) / f64::from(count) * 1e6;
        eprintln!("{} MB of shape; new {new:.1} us, follow {step:.1} us ({contacts} contacts of {count}), clone {clone:.1} us", shape.memory_bytes() / 1_000_000);
        // Generous: the machine may be busy.
        assert!(new < 1000.0 && step < 500.0);
    }
}
