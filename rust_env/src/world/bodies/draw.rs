//! Which bodies an episode has: given ones, the scene's actors, and others drawn where there is room.
use super::{Bodies, PushedBox, Walker, DENSITY, HEIGHT, RADIUS};
use crate::error::{Error, Result};
use crate::geometry::{Vec2, Vec3};
use crate::world::SceneAssets;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rapier3d::math::Pose;
use rapier3d::parry::shape::{Capsule, Cuboid};
use std::f32::consts::TAU;

/// Most walkers, and most boxes, of an episode.
pub const MAX_BODIES: usize = 64;
/// Places that are tried for a body.
const TRIES: usize = 2000;
/// Metres between what stands on the floor and the floor; bumps and carpets are lower.
const ABOVE_FLOOR: f32 = 0.03;
/// Room that is kept around drawn bodies, metres.
const ROOM: f32 = 0.05;
/// The longest way that is looked for at once, metres, and the shortest walk.
const FAR: f32 = 6.0;
const SHORT: f32 = 0.8;

/// What moves in the episodes of a task. Given boxes fall from where they are, drawn ones stand on the floor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BodiesSpec {
    /// Whether the scene's own actors walk.
    pub actors: bool,
    pub walkers: Vec<Walker>,
    pub boxes: Vec<GivenBox>,
    /// How many more are drawn from the episode's random stream.
    pub drawn_walkers: usize,
    pub drawn_boxes: usize,
}

/// A box where it is told to be; without a height it stands on the scene's floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GivenBox {
    pub pushed: PushedBox,
    pub on_floor: bool,
}

impl BodiesSpec {
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// This value if it asks for no more bodies than there may be.
    pub fn checked(self) -> Result<Self> {
        for (name, given, drawn) in [
            ("walkers", self.walkers.len(), self.drawn_walkers),
            ("boxes", self.boxes.len(), self.drawn_boxes),
        ] {
            if given.saturating_add(drawn) > MAX_BODIES {
                return Err(Error::invalid(format!(
                    "bodies {name} must be at most {MAX_BODIES}, got {}",
                    given.max(drawn)
                )));
            }
        }
        Ok(self)
    }

    /// The bodies of an episode that begins with the robot at `start`, where nothing is put within `keep_out` metres;
    /// `rng` is asked only for drawn ones.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the scene has no room for a drawn body.
    pub fn draw(
        &self,
        assets: &SceneAssets,
        robot_radius: f32,
        keep_out: f32,
        start: Vec3,
        rng: &mut Pcg64Mcg,
    ) -> Result<Bodies> {
        let floor = assets.scene.floor;
        let mut walkers = self.walkers.clone();
        if self.actors {
            let actors = assets.scene.actors.iter().take(MAX_BODIES);
            walkers.extend(actors.cloned());
        }
        for walker in &mut walkers {
            walker.floor = floor;
        }
        let mut boxes: Vec<PushedBox> = Vec::new();
        for given in &self.boxes {
            let mut pushed = given.pushed;
            if given.on_floor {
                pushed.position.z = floor + 0.5 * pushed.size.z;
            }
            boxes.push(pushed);
        }
        let mut taken = vec![(start.truncate(), keep_out + 0.3)];
        taken.extend(walkers.iter().map(|w| (w.position().truncate(), w.radius)));
        taken.extend(boxes.iter().map(|b| {
            let reach = 0.5 * b.size.length();
            (b.position.truncate(), reach)
        }));
        let mut drawing = Drawing {
            assets,
            start,
            robot_radius,
            taken,
            rng,
        };
        for i in 0..self.drawn_boxes {
            let drawn = drawing.pushed_box();
            boxes.push(drawn.ok_or_else(|| drawing.no_room("box", i, self.drawn_boxes))?);
        }
        for i in 0..self.drawn_walkers {
            let drawn = drawing.walker();
            walkers.push(drawn.ok_or_else(|| drawing.no_room("walker", i, self.drawn_walkers))?);
        }
        Ok(Bodies::new(walkers, boxes, self.boxes.is_empty()))
    }
}

struct Drawing<'a> {
    assets: &'a SceneAssets,
    start: Vec3,
    robot_radius: f32,
    /// Centres and radii of what stands on the floor already.
    taken: Vec<(Vec2, f32)>,
    rng: &'a mut Pcg64Mcg,
}

impl Drawing<'_> {
    fn no_room(&self, what: &str, i: usize, of: usize) -> Error {
        Error::invalid(format!(
            "scene {:?} has no room for {what} {} of {of}",
            self.assets.scene.name,
            i + 1
        ))
    }

    fn uniform(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.rng.random::<f32>()
    }

    fn heading(&mut self) -> Vec3 {
        let (sin, cos) = self.uniform(0.0, TAU).sin_cos();
        Vec3::new(cos, sin, 0.0)
    }

    /// Somewhere on the floor in the same room, or the next: two straight flights from the start lead above it.
    fn place(&mut self) -> Vec2 {
        let mut at = self.start;
        for _ in 0..2 {
            let heading = self.heading();
            let free = self.assets.shape.sweep(at, heading, FAR, self.robot_radius);
            at += heading * self.uniform(0.0, free);
        }
        at.truncate()
    }

    /// Whether nothing hollow stands below the flight: whoever is set down must not end inside it.
    fn is_open(&self, at: Vec2) -> bool {
        let (from, radius) = (at.extend(self.start.z), self.robot_radius);
        let drop = self.start.z - self.assets.scene.floor - radius - ABOVE_FLOOR;
        drop <= 0.0 || self.assets.shape.sweep(from, Vec3::NEG_Z, drop, radius) >= drop
    }

    fn is_taken(&self, at: Vec2, radius: f32) -> bool {
        let near = |(p, r): &(Vec2, f32)| p.distance(at) < r + radius + ROOM;
        self.taken.iter().any(near)
    }

    fn pushed_box(&mut self) -> Option<PushedBox> {
        let floor = self.assets.scene.floor;
        for _ in 0..TRIES {
            let size = Vec3::new(
                self.uniform(0.3, 0.6),
                self.uniform(0.3, 0.6),
                self.uniform(0.3, 1.2),
            );
            let yaw = self.uniform(0.0, TAU);
            let at = self.place();
            let reach = 0.5 * size.truncate().length();
            if self.is_taken(at, reach) || !self.is_open(at) {
                continue;
            }
            let centre = at.extend(floor + 0.5 * size.z);
            let pushed = PushedBox::new(size, f64::from(DENSITY), centre, f64::from(yaw)).ok()?;
            let grown = Cuboid::new(0.5 * size + ROOM - Vec3::Z * ROOM);
            let pose = Pose::from_parts(
                centre + Vec3::Z * ABOVE_FLOOR,
                rapier3d::math::Rotation::from_array(pushed.rotation.to_array()),
            );
            if !self.assets.shape.meets(&grown, &pose) {
                self.taken.push((at, reach));
                return Some(pushed);
            }
        }
        None
    }

    /// Somebody who walks back and forth along a straight line.
    fn walker(&mut self) -> Option<Walker> {
        let floor = self.assets.scene.floor;
        let half = 0.5 * HEIGHT - RADIUS;
        let capsule = Capsule::new_z(half, RADIUS + ROOM);
        for _ in 0..TRIES {
            let at = self.place();
            if self.is_taken(at, RADIUS) || !self.is_open(at) {
                continue;
            }
            let pose = Pose::from_translation(at.extend(floor + ABOVE_FLOOR + ROOM + 0.5 * HEIGHT));
            if self.assets.shape.meets(&capsule, &pose) {
                continue;
            }
            // As far as balls up the whole axis can go.
            let heading = self.heading();
            let mut free = FAR;
            let mut z = floor + ABOVE_FLOOR + RADIUS;
            while z <= floor + HEIGHT - RADIUS {
                free = self.assets.shape.sweep(at.extend(z), heading, free, RADIUS);
                z += 0.5 * RADIUS;
            }
            let end = at + heading.truncate() * (free - ROOM);
            if free - ROOM < SHORT {
                continue;
            }
            let speed = f64::from(self.uniform(0.6, 1.2));
            let (radius, height) = (f64::from(RADIUS), f64::from(HEIGHT));
            let mut walker = Walker::new(vec![at, end], false, speed, radius, height).ok()?;
            walker.floor = floor;
            self.taken.push((at, RADIUS));
            return Some(walker);
        }
        None
    }
}
