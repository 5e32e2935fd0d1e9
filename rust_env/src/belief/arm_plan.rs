//! Ways of an arm through the map: which views it can take, and how it gets there.
//!
//! A posture is clear if the map holds nothing occupied within its links; unknown space does not forbid it, since the
//! camera looks outwards and never sees where the arm itself is. Where the straight swing is not clear, ways lead from
//! view to neighbouring view of the dome. Postures are checked at each view: neighbours are about a voxel apart.
use super::octree::Octree;
use super::viewpoints::{capsule_is_clear, sphere_is_clear, ViewSpace};
use crate::arm::{Arm, Posture};
use crate::geometry::{Pose, Vec3};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Least distance between checked postures of a swing, metres; wider in coarse maps.
const STEP: f32 = 0.02;

/// An arm, what it knows and the dome around it.
pub struct ArmPlan<'a> {
    pub octree: &'a Octree,
    pub arm: &'a Arm,
    pub shoulder: Vec3,
    /// Radius of the ball around the camera, metres.
    pub ball: f32,
    pub space: &'a ViewSpace,
    pub views: &'a [Pose],
}

impl ArmPlan<'_> {
    /// May the arm be held with its hand there?
    pub fn is_clear_at(&self, hand: Vec3) -> bool {
        self.arm.reaches(self.shoulder, hand)
            && self.links_are_clear(&self.arm.posture(self.shoulder, hand))
    }

    fn links_are_clear(&self, posture: &Posture) -> bool {
        let links = self.arm.links(self.shoulder, posture);
        links.iter().all(|link| capsule_is_clear(self.octree, link))
    }

    /// Can the arm swing straight from one point to another?
    pub fn swing_is_clear(&self, from: Vec3, to: Vec3) -> bool {
        let posture = |hand| self.arm.posture(self.shoulder, hand);
        let step = STEP.max(0.5 * self.octree.resolution() as f32);
        let mut swing = self.arm.swing(posture(from), posture(to), step);
        self.arm.reaches(self.shoulder, to)
            && swing.all(|p| {
                let hand = self.arm.joints(self.shoulder, &p).1;
                sphere_is_clear(self.octree, hand, self.ball, true) && self.links_are_clear(&p)
            })
    }

    /// Way-points of the hand from `from` to `to`, both included: straight if that swing is clear, else from view to view.
    /// `None` if there is no way.
    pub fn plan(&self, from: Vec3, to: Vec3) -> Option<Vec<Vec3>> {
        if self.swing_is_clear(from, to) {
            return Some(vec![from, to]);
        }
        if !self.is_clear_at(to) {
            return None;
        }
        let goal = self.nearest(to)?;
        let costs = self.search(from, Some(goal));
        let mut at = costs.get(goal)?.as_ref()?.1;
        let mut points = vec![to, self.views[goal].translation];
        while let Some(view) = at {
            points.push(self.views[view].translation);
            at = costs[view].as_ref()?.1;
        }
        points.push(from);
        points.reverse();
        Some(self.shortened(&points))
    }

    /// Take way-points out as long as the straight swing past them is clear.
    fn shortened(&self, points: &[Vec3]) -> Vec<Vec3> {
        let mut path = vec![points[0]];
        let mut at = 0;
        while at + 1 < points.len() {
            let mut next = at + 1;
            while next + 1 < points.len() && self.swing_is_clear(points[at], points[next + 1]) {
                next += 1;
            }
            path.push(points[next]);
            at = next;
        }
        path
    }

    /// Metres of the hand's way to each goal from view to neighbouring view; infinite where the arm cannot be held, or
    /// cannot get.
    pub fn travel_costs(&self, from: Vec3, goals: &[Vec3]) -> Vec<f32> {
        let costs = self.search(from, None);
        let cost = |goal: &Vec3| {
            if *goal == from {
                return Some(0.0);
            }
            let view = self.nearest(*goal).filter(|_| self.is_clear_at(*goal))?;
            let (metres, _) = costs[view]?;
            Some(metres + goal.distance(self.views[view].translation))
        };
        goals
            .iter()
            .map(|g| cost(g).unwrap_or(f32::INFINITY))
            .collect()
    }

    fn nearest(&self, point: Vec3) -> Option<usize> {
        let apart = |i: &usize| self.views[*i].translation.distance(point);
        (0..self.views.len()).min_by(|a, b| apart(a).total_cmp(&apart(b)))
    }

    /// Dijkstra from the view nearest to `from`, whether the arm could be held there or not: by view, the metres from
    /// `from` and the view before it. Stops when `goal` is found.
    #[allow(clippy::type_complexity)]
    fn search(&self, from: Vec3, goal: Option<usize>) -> Vec<Option<(f32, Option<usize>)>> {
        let mut best: Vec<Option<(f32, Option<usize>)>> = vec![None; self.views.len()];
        let mut clear: Vec<Option<bool>> = vec![None; self.views.len()];
        let mut done = vec![false; self.views.len()];
        // Metres are not negative: as bits they are ordered alike.
        let mut queue = BinaryHeap::new();
        if let Some(start) = self.nearest(from) {
            let metres = self.views[start].translation.distance(from);
            best[start] = Some((metres, None));
            queue.push(Reverse((metres.to_bits(), start)));
        }
        while let Some(Reverse((bits, view))) = queue.pop() {
            if std::mem::replace(&mut done[view], true) {
                continue;
            }
            if goal == Some(view) {
                break;
            }
            let here = self.views[view].translation;
            for next in self.space.neighbours(view) {
                let there = self.views[next].translation;
                let metres = f32::from_bits(bits) + here.distance(there);
                if done[next] || best[next].is_some_and(|(known, _)| known <= metres) {
                    continue;
                }
                let is_clear = *clear[next].get_or_insert_with(|| {
                    sphere_is_clear(self.octree, there, self.ball, true) && self.is_clear_at(there)
                });
                if is_clear {
                    best[next] = Some((metres, Some(view)));
                    queue.push(Reverse((metres.to_bits(), next)));
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests;
