//! What the robot knows: the map, its own estimated pose, and what can be computed from these two.
pub mod arm_plan;
pub mod cast;
mod clearance;
pub mod contact;
mod curve;
mod distance;
pub mod frontier;
pub mod gain;
pub mod grid;
pub mod integrate;
mod lattice;
pub mod lockstep;
pub mod map_file;
mod misses;
pub mod nbvmap;
pub mod octomap_file;
pub mod octree;
pub mod plan;
pub mod ray_walk;
#[cfg(test)]
mod testing;
pub mod uncertainty;
pub mod view_history;
pub mod viewpoints;

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::geometry::{Aabb, IVec3, Pose, Quat, Vec3};
use crate::robot::Robot;
use crate::setup::{LocalMap, Setup};
use arm_plan::ArmPlan;
use clearance::Clearance;
use contact::{Contacts, Missed};
use gain::{Gain, RaySpacing};
use integrate::{Integrator, Optics};
use octree::{probability, Change, Octree, State, States};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::sync::Arc;
use uncertainty::UncertaintyModel;
use viewpoints::ViewSpace;

/// What the robot is told before it has seen anything.
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    /// Where exploration takes place, metres.
    pub bounds: Aabb,
    pub start: Pose,
    /// Centre of the dome or ring of candidate views.
    pub anchor: Vec3,
}

/// A planner's view of the world. Everything in it comes from images, poses and the prior.
#[derive(Clone)]
pub struct Belief {
    setup: Arc<Setup>,
    octree: Octree,
    model: UncertaintyModel,
    /// Held so that integrators find them.
    optics: Arc<Optics>,
    pose: Pose,
    bounds: Aabb,
    /// Centre of fixed candidates, and the shoulder of an arm.
    anchor: Vec3,
    candidates: Vec<Pose>,
    /// Of the candidates, if they are fixed (and the lists not too long).
    clearance: Option<Clearance>,
    /// How often each fixed candidate was gone to.
    visited: Vec<u16>,
    trajectory: Vec<Pose>,
    contacts: Contacts,
}

/// What of a belief is not given by its setup and prior.
#[derive(Serialize, Deserialize)]
pub struct BeliefState<'a> {
    pose: [f32; 7],
    visited: Vec<u16>,
    trajectory: Vec<[f32; 7]>,
    /// Goals that were missed, where the robot was stopped, and how near it came.
    missed: Vec<([f32; 3], [f32; 3], f32)>,
    /// As an `.nbvmap` file.
    #[serde(borrow)]
    map: Cow<'a, [u8]>,
    /// The map's notes of what changed: bricks, known and occupied voxels before.
    changes: Option<Vec<NotedBrick>>,
}

type NotedBrick = ([i32; 3], [u64; 8], [u64; 8]);

impl Belief {
    pub fn new(setup: &Arc<Setup>, prior: Prior) -> Result<Self> {
        Self::after(None, setup, prior)
    }

    /// The same, with the memory of a belief that is no longer needed.
    pub fn after(before: Option<Self>, setup: &Arc<Setup>, prior: Prior) -> Result<Self> {
        let before = before.filter(|old| Arc::ptr_eq(&old.setup, setup));
        let views = &setup.views;
        let same_views = |old: &Self| {
            views.is_fixed() && old.anchor == prior.anchor && old.bounds == prior.bounds
        };
        let (octree, optics, lists) = match before {
            None => (None, None, None),
            Some(old) => {
                let lists = same_views(&old).then_some((old.candidates, old.clearance));
                (Some(old.octree), Some(old.optics), lists)
            }
        };
        let map = &setup.map;
        let octree = match octree {
            Some(old) => old.emptied(),
            None if map.view_history => {
                Octree::new(map.resolution, map.sensor)?.with_view_history()
            }
            None => Octree::new(map.resolution, map.sensor)?,
        };
        let octree = octree.limited_to(&prior.bounds)?;
        let (candidates, clearance) = match lists {
            Some((candidates, mut clearance)) => {
                clearance.iter_mut().for_each(Clearance::forget);
                (candidates, clearance)
            }
            None => {
                let candidates = views.views(&prior.start, prior.anchor);
                let radius = setup.robot.radius();
                let clearance = || Clearance::new(&octree, &prior.bounds, &candidates, radius);
                let clearance = if views.is_fixed() { clearance() } else { None };
                (candidates, clearance)
            }
        };
        let model = UncertaintyModel::of_camera(&setup.camera);
        Ok(Self {
            octree,
            optics: optics.unwrap_or_else(|| Optics::of(&setup.camera, &model)),
            model,
            pose: prior.start,
            bounds: prior.bounds,
            anchor: prior.anchor,
            visited: vec![0; candidates.len()],
            candidates,
            clearance,
            trajectory: vec![prior.start],
            contacts: Contacts::default(),
            setup: setup.clone(),
        })
    }

    /// What [`Belief::load`] needs to go on from here.
    pub fn save(&self) -> BeliefState<'static> {
        let notes = |s: &States| (s.brick.to_array(), s.known, s.occupied);
        let missed = self.contacts.missed().iter();
        BeliefState {
            pose: self.pose.to_array(),
            visited: self.visited.clone(),
            trajectory: self.trajectory.iter().map(|p| p.to_array()).collect(),
            missed: missed
                .map(|m| (m.goal.to_array(), m.stopped.to_array(), m.nearest))
                .collect(),
            map: Cow::Owned(nbvmap::serialise(&self.octree)),
            changes: self
                .octree
                .noted()
                .map(|before| before.iter().map(notes).collect()),
        }
    }

    /// A belief as it was saved. The bytes may come from anywhere: what does not fit the setup is an error.
    pub fn load(setup: &Arc<Setup>, prior: Prior, state: &BeliefState) -> Result<Self> {
        let mut belief = Self::new(setup, prior)?;
        if state.visited.len() != belief.visited.len() || state.trajectory.is_empty() {
            return Err(Error::invalid(format!(
                "the belief was saved with {} candidates and {} poses; there are {} candidates",
                state.visited.len(),
                state.trajectory.len(),
                belief.visited.len()
            )));
        }
        let map = nbvmap::parse(&state.map, Some(&belief.octree)).map_err(Error::Invalid)?;
        belief.octree = map;
        belief.learn_clearance();
        if let Some(notes) = &state.changes {
            let before = notes.iter().map(|(brick, known, occupied)| States {
                brick: IVec3::from_array(*brick),
                known: *known,
                occupied: *occupied,
            });
            belief.octree.restore_noted(before.collect());
        }
        belief.pose = Pose::from_array(state.pose)?;
        belief.trajectory = state
            .trajectory
            .iter()
            .map(|p| Pose::from_array(*p))
            .collect::<Result<_>>()?;
        belief.visited.clone_from(&state.visited);
        let missed = state.missed.iter().map(|(goal, stopped, nearest)| Missed {
            goal: Vec3::from_array(*goal),
            stopped: Vec3::from_array(*stopped),
            nearest: *nearest,
        });
        belief.contacts = Contacts::new(missed.collect());
        belief.follow_pose();
        Ok(belief)
    }

    /// Way-points (positions, metres) to a goal: straight if nothing known is in the way, else around what is known.
    /// If no way is known the robot tries the straight line.
    pub fn plan(&self, goal: &Pose) -> Vec<Vec3> {
        let (from, to) = (self.pose.translation, goal.translation);
        let path = match self.arm_plan() {
            Some(arm) => arm.plan(from, to),
            None => plan::plan(&self.octree, &self.bounds, from, to, self.radius()),
        };
        path.unwrap_or_else(|| vec![from, to])
    }

    /// The robot went towards `goal` and believes to be at `pose`.
    pub fn moved(&mut self, goal: &Pose, pose: Pose) {
        if self.setup.views.is_fixed() {
            if let Some(i) = self.candidates.iter().position(|c| c == goal) {
                self.visited[i] = self.visited[i].saturating_add(1);
            }
        }
        let tolerance = self.octree.resolution() as f32 / 2.0;
        // An arm's elbow may have been stopped: how far its hand was from the goal then tells nothing of what lies between.
        let most = match self.setup.robot.arm() {
            Some(_) => self.radius().max(2.0 * tolerance),
            None => f32::INFINITY,
        };
        self.contacts
            .learn(goal.translation, pose.translation, tolerance, most);
        self.pose = pose;
        self.trajectory.push(pose);
        self.follow_pose();
    }

    /// Candidates that move with the robot.
    fn follow_pose(&mut self) {
        if let ViewSpace::SixDirections { .. } = self.setup.views {
            let pose = &self.pose;
            self.candidates = self.setup.views.views(pose, pose.translation);
        }
    }

    /// The voxels whose state changed since the last call, or since the episode began; see [`Octree::changed`].
    pub fn changed(&mut self) -> Vec<Change> {
        self.octree.changed()
    }

    /// Put a depth image taken at the current pose into the map.
    pub fn observe(&mut self, image: &[f32]) -> Result<()> {
        let setup = &self.setup;
        let range = Some(setup.map.max_range);
        Integrator::of_this_thread(|integrator| {
            integrator.using(setup.map.integration).insert_depth(
                &mut self.octree,
                image,
                &setup.camera,
                &self.pose,
                range,
                &self.model,
            )
        })?;
        if setup.map.view_history {
            self.octree
                .record_view(&setup.camera, &self.pose, setup.map.max_range as f32)?;
        }
        self.learn_clearance();
        Ok(())
    }

    fn learn_clearance(&mut self) {
        if let Some(clearance) = &mut self.clearance {
            clearance.update(&self.octree);
        }
    }

    pub fn octree(&self) -> &Octree {
        &self.octree
    }
    pub fn pose(&self) -> &Pose {
        &self.pose
    }
    pub fn bounds(&self) -> &Aabb {
        &self.bounds
    }
    pub fn camera(&self) -> &Camera {
        &self.setup.camera
    }
    pub fn setup(&self) -> &Setup {
        &self.setup
    }
    pub fn candidates(&self) -> &[Pose] {
        &self.candidates
    }
    /// Candidates next to the one that the camera is nearest to, ascending; none where candidates move with the camera.
    pub fn neighbours(&self) -> Vec<usize> {
        // Where the robot was stopped on its way it looks as at the goal: the place decides, then where it looks.
        let apart = |i: &usize| {
            let view = &self.candidates[*i];
            let metres = view.translation.distance(self.pose.translation);
            (metres, view.angle_to(&self.pose))
        };
        let nearer =
            |a: &(f32, f32), b: &(f32, f32)| a.0.total_cmp(&b.0).then_with(|| a.1.total_cmp(&b.1));
        match (0..self.candidates.len()).min_by(|a, b| nearer(&apart(a), &apart(b))) {
            Some(here) => self.setup.views.neighbours(here),
            None => Vec::new(),
        }
    }
    pub fn visited(&self) -> &[u16] {
        &self.visited
    }
    pub fn trajectory(&self) -> &[Pose] {
        &self.trajectory
    }
    /// Voxels within the exploration bounds.
    pub fn volume(&self) -> u64 {
        self.octree.limits().map_or(0, |l| l.volume())
    }
    fn radius(&self) -> f32 {
        let robot: &Robot = &self.setup.robot;
        robot.radius()
    }

    /// If the robot is an arm: what it can reach.
    fn arm_plan(&self) -> Option<ArmPlan<'_>> {
        self.setup.robot.arm().map(|arm| ArmPlan {
            octree: &self.octree,
            arm,
            shoulder: self.anchor,
            ball: self.radius(),
            space: &self.setup.views,
            views: &self.candidates,
        })
    }

    /// May the robot be sent there, as far as it knows: inside the bounds, nothing occupied within its body, an arm's links
    /// included, for a step in one of six directions nothing occupied on the way, and not where touch taught it better ([`Contacts`]).
    pub fn is_admissible(&self, goal: &Pose) -> bool {
        self.contacts.allow(goal.translation) && self.looks_admissible(goal)
    }

    /// The same by what was seen alone.
    fn looks_admissible(&self, goal: &Pose) -> bool {
        if !viewpoints::admissible(&self.octree, &self.bounds, goal, self.radius()) {
            return false;
        }
        if let Some(arm) = self.arm_plan() {
            return arm.is_clear_at(goal.translation);
        }
        self.setup.views.is_fixed()
            || viewpoints::segment_is_clear(
                &self.octree,
                self.pose.translation,
                goal.translation,
                self.radius(),
                true,
            )
    }

    /// Which candidates are admissible; where touch leaves none, those that look admissible.
    pub fn mask(&self, out: &mut [bool]) {
        let arm = self.arm_plan();
        let looks = |number: usize| match (&self.clearance, &arm) {
            (Some(clearance), None) => clearance.is_clear(number),
            // Its list is of the ball around the camera.
            (Some(clearance), Some(arm)) => {
                clearance.is_clear(number) && arm.is_clear_at(self.candidates[number].translation)
            }
            (None, _) => self.looks_admissible(&self.candidates[number]),
        };
        let allows = |number: usize| self.contacts.allow(self.candidates[number].translation);
        let all = 0..self.candidates.len();
        for (out, number) in out.iter_mut().zip(all.clone()) {
            *out = looks(number) && allows(number);
        }
        if !self.contacts.missed().is_empty() && !out.contains(&true) {
            for (out, number) in out.iter_mut().zip(all) {
                *out = looks(number);
            }
        }
    }

    pub fn view_gain(
        &self,
        views: &[Pose],
        gain: Gain,
        rays: impl Into<RaySpacing>,
        pool: Option<&rayon::ThreadPool>,
    ) -> Result<Vec<f64>> {
        let range = self.setup.map.max_range as f32;
        gain::view_gain(
            &self.octree,
            views,
            self.camera(),
            gain,
            rays,
            range,
            Some(self.bounds),
            pool,
        )
    }

    /// Metres to each goal through space that is not known to be occupied; infinite where there is no way.
    /// For an arm from view to neighbouring view, the way of its hand.
    pub fn travel_costs(&self, goals: &[Vec3]) -> Vec<f32> {
        if let Some(arm) = self.arm_plan() {
            return arm.travel_costs(self.pose.translation, goals);
        }
        plan::travel_costs(
            &self.octree,
            &self.bounds,
            self.pose.translation,
            goals,
            self.radius(),
        )
    }

    /// Which goals can be reached through known free space; for an arm through space that is not known to be occupied,
    /// since it never sees where its links are.
    pub fn reachable(&self, goals: &[Vec3]) -> Vec<bool> {
        if self.setup.robot.arm().is_some() {
            let costs = self.travel_costs(goals);
            return costs.iter().map(|c| c.is_finite()).collect();
        }
        plan::reachable(
            &self.octree,
            &self.bounds,
            self.pose.translation,
            goals,
            self.radius(),
        )
    }

    /// Centres of the known free voxels next to unknown ones.
    pub fn frontiers(&self) -> Vec<Vec3> {
        frontier::frontier_voxels(&self.octree, Some(&self.bounds))
            .into_iter()
            .map(|k| self.octree.center(k))
            .collect()
    }

    pub fn sample_free(&self, count: usize, rng: &mut Pcg64Mcg) -> Vec<Pose> {
        let mut views = viewpoints::uniform_in_free_space(&self.octree, count, rng, self.radius());
        if let Some(arm) = self.arm_plan() {
            views.retain(|v| arm.is_clear_at(v.translation));
        }
        views
    }

    /// The egocentric map: three channels of `size`^3 cells (z, y, x; x forward, y left, z up, the camera in the
    /// middle, turned by its heading): occupancy probability (0.5 where unknown), uncertainty, unknown (0 or 1).
    pub fn local_map(&self, window: &LocalMap, out: &mut [f32]) {
        let n = window.size;
        let cells = window.cells();
        let turn = Quat::from_rotation_z(self.pose.yaw());
        let cell = window.cell as f32;
        let axis = |v: Vec3| turn * v * cell;
        let (dx, dy, dz) = (axis(Vec3::X), axis(Vec3::Y), axis(Vec3::Z));
        let corner = self.pose.translation - (dx + dy + dz) * ((n as f32 - 1.0) / 2.0);
        let (occupancy, rest) = out.split_at_mut(cells);
        let (uncertainty, unknown) = rest.split_at_mut(cells);
        for z in 0..n {
            for y in 0..n {
                let row = corner + dz * z as f32 + dy * y as f32;
                for x in 0..n {
                    let i = (z * n + y) * n + x;
                    let key = self.octree.key(row + dx * x as f32);
                    let known = key.and_then(|k| self.octree.log_odds(k));
                    occupancy[i] = known.map_or(0.5, |l| probability(l) as f32);
                    unknown[i] = if known.is_some() { 0.0 } else { 1.0 };
                    uncertainty[i] = match key {
                        Some(k) if self.octree.state(k) == State::Occupied => {
                            self.octree.uncertainty(k)
                        }
                        Some(_) if known.is_some() => 0.0,
                        _ => 1.0,
                    };
                }
            }
        }
    }
}
