//! Boxes that a robot pushes: rapier's rigid bodies, between motions as plain numbers.
use super::TICK;
use crate::capsule::Capsule;
use crate::error::{Error, Result};
use crate::geometry::{Quat, Vec3};
use crate::world::bodies::walker::Walker;
use crate::world::motion::SceneShape;
use rapier3d::math::{Pose, Rotation};
use rapier3d::prelude::{ColliderBuilder, PhysicsWorld, RigidBodyBuilder, RigidBodyHandle};
use serde::{Deserialize, Serialize};

/// Kilograms in a cubic metre: a packed carton.
pub const DENSITY: f32 = 60.0;

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PushedBox {
    /// Length, width and height in its own frame, metres.
    pub size: Vec3,
    /// kg/m^3.
    pub density: f32,
    /// Its centre, metres, and orientation.
    pub position: Vec3,
    pub rotation: Quat,
    /// m/s and rad/s.
    pub velocity: Vec3,
    pub spin: Vec3,
}

impl PushedBox {
    /// A box at rest with its centre at `position`.
    pub fn new(size: Vec3, density: f64, position: Vec3, yaw: f64) -> Result<Self> {
        // All false for NaN.
        let within = |v: Vec3, low: f32, high: f32| {
            v.cmpge(Vec3::splat(low)).all() && v.cmple(Vec3::splat(high)).all()
        };
        if !within(size, 0.02, 10.0) {
            return Err(Error::invalid(format!(
                "box size must lie in [0.02, 10] m per side, got {size}"
            )));
        }
        if !(1.0..=20_000.0).contains(&density) {
            return Err(Error::invalid(format!(
                "box density must lie in [1, 20000] kg/m^3, got {density}"
            )));
        }
        if !within(position, -1e6, 1e6) {
            return Err(Error::invalid(format!(
                "box position must lie within 1e6 m, got {position}"
            )));
        }
        if !yaw.is_finite() {
            return Err(Error::invalid(format!("box yaw must be finite, got {yaw}")));
        }
        Ok(Self {
            size,
            density: density as f32,
            position,
            rotation: Quat::from_rotation_z(yaw as f32),
            velocity: Vec3::ZERO,
            spin: Vec3::ZERO,
        })
    }

    /// An error if this cannot be a box's state.
    pub fn check(&self) -> Result<()> {
        Self::new(self.size, f64::from(self.density), self.position, 0.0)?;
        let sound = (self.rotation.length() - 1.0).abs() < 1e-3
            && self.velocity.abs().max_element() <= 1e4
            && self.spin.abs().max_element() <= 1e4
            && self.velocity.is_finite()
            && self.spin.is_finite();
        if sound {
            Ok(())
        } else {
            Err(Error::invalid(format!(
                "a box's rotation must be a unit quaternion and its velocities finite, got {}, {} and {}",
                self.rotation, self.velocity, self.spin
            )))
        }
    }

    /// The point of the box nearest to `p`; `p` itself if it lies inside.
    pub fn nearest(&self, p: Vec3) -> Vec3 {
        let half = 0.5 * self.size;
        let own = self.rotation.inverse() * (p - self.position);
        self.position + self.rotation * own.clamp(-half, half)
    }

    /// Upper bound of the speed of its points, m/s.
    pub fn speed(&self) -> f32 {
        self.velocity.length() + 0.5 * self.spin.length() * self.size.length()
    }
}

/// The boxes in rapier, with the scene, the robot's parts and the walkers: made for a stretch of time in which boxes move.
pub struct Stage {
    world: PhysicsWorld,
    robot: Vec<RigidBodyHandle>,
    walkers: Vec<RigidBodyHandle>,
    boxes: Vec<RigidBodyHandle>,
}

fn pose(position: Vec3, rotation: Quat) -> Pose {
    Pose::from_parts(position, Rotation::from_array(rotation.to_array()))
}

impl Stage {
    pub fn new(
        shape: &SceneShape,
        robot: &[Capsule],
        walkers: &[Walker],
        boxes: &[PushedBox],
    ) -> Self {
        let mut world = shape.world();
        world.integration_parameters.dt = TICK as f32;
        let robot = robot.iter().map(|part| {
            let body = RigidBodyBuilder::kinematic_position_based().pose(part_pose(part));
            let collider = if part.a == part.b {
                ColliderBuilder::ball(part.radius)
            } else {
                ColliderBuilder::capsule_z(0.5 * part.a.distance(part.b), part.radius)
            };
            world.insert(body, collider).0
        });
        let robot = robot.collect();
        let walkers = walkers.iter().map(|w| {
            let body = RigidBodyBuilder::kinematic_position_based().translation(middle(w));
            let capsule = ColliderBuilder::capsule_z(0.5 * w.height - w.radius, w.radius);
            world.insert(body, capsule).0
        });
        let walkers = walkers.collect();
        let boxes = boxes.iter().map(|b| {
            // When boxes come to rest is decided by us: rapier's own clock of stillness cannot be saved.
            let body = RigidBodyBuilder::dynamic()
                .pose(pose(b.position, b.rotation))
                .linvel(b.velocity)
                .angvel(b.spin)
                .can_sleep(false);
            let half = 0.5 * b.size;
            let collider = ColliderBuilder::cuboid(half.x, half.y, half.z).density(b.density);
            world.insert(body, collider).0
        });
        let boxes = boxes.collect();
        Self {
            world,
            robot,
            walkers,
            boxes,
        }
    }

    /// One tick: robot and walkers move to where they are now, boxes by the laws of motion.
    pub fn step(&mut self, robot: &[Capsule], walkers: &[Walker], boxes: &mut [PushedBox]) {
        for (handle, part) in self.robot.iter().zip(robot) {
            self.world.bodies[*handle].set_next_kinematic_position(part_pose(part));
        }
        for (handle, walker) in self.walkers.iter().zip(walkers) {
            self.world.bodies[*handle].set_next_kinematic_translation(middle(walker));
        }
        self.world.step();
        for (handle, pushed) in self.boxes.iter().zip(boxes) {
            let body = &self.world.bodies[*handle];
            let position = body.translation();
            let rotation = Quat::from_array(body.rotation().to_array());
            // rapier switches a body off whose state is not finite; here it then stays where it was.
            if position.is_finite() && rotation.is_finite() {
                pushed.position = position;
                pushed.rotation = rotation;
                pushed.velocity = body.linvel();
                pushed.spin = body.angvel();
            }
        }
    }
}

/// Where the middle of a part is; its axis is z.
fn part_pose(part: &Capsule) -> Pose {
    let along = (part.b - part.a).normalize_or(Vec3::Z);
    pose(
        (part.a + part.b) * 0.5,
        Quat::from_rotation_arc(Vec3::Z, along),
    )
}

fn middle(walker: &Walker) -> Vec3 {
    walker.position() + Vec3::Z * (0.5 * walker.height)
}
