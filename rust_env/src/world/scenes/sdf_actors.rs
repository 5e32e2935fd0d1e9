//! SDF's `<actor>`: a person who walks along the way-points of a script, or between a pose and a plugin's target.
use glam::DMat4;
use roxmltree::Node;

use super::sdf_frames::{pose, Frames};
use super::text::{child, children, content, numbers};
use crate::geometry::Vec2;
use crate::world::bodies::{Walker, HEIGHT, RADIUS, SPEED};

/// A script whose last way-point is as near to its first is a round, metres.
const CLOSED: f32 = 0.5;

/// What is told of an actor, skin and animation apart. Way-points are in the world frame; the walk has one speed, the
/// script's mean. Without a script: from the actor's pose to the target of its plugin (as in Gazebo's cafe world), which
/// Gazebo's own plugin then draws anew, and back; without a target somebody who stands.
pub(super) fn walker(
    actor: Node,
    frames: &Frames,
    world_from_scope: DMat4,
) -> Result<Walker, String> {
    let begin = flat(world_from_scope * frames.place(actor, DMat4::IDENTITY)?);
    let mut path = Vec::new();
    let mut times = Vec::new();
    let script = child(actor, "script");
    let trajectories = script.into_iter().flat_map(|s| children(s, "trajectory"));
    for point in trajectories.flat_map(|t| children(t, "waypoint")) {
        path.push(flat(pose(point)?));
        times.push(child(point, "time").map_or(Ok(f64::NAN), |t| {
            let text = content(t);
            text.parse::<f64>()
                .map_err(|_| format!("<time> holds '{text}', not a number"))
        })?);
    }
    let length: f32 = path.windows(2).map(|p| p[0].distance(p[1])).sum();
    let seconds = match times[..] {
        [first, .., last] => last - first,
        _ => f64::NAN,
    };
    let mean = f64::from(length) / seconds;
    // False for NaN.
    let speed = if (0.01..=10.0).contains(&mean) {
        mean
    } else {
        f64::from(SPEED)
    };
    let round = path.len() > 3 && path[0].distance(path[path.len() - 1]) < CLOSED;
    if round {
        path.pop();
    }
    if path.is_empty() {
        path.push(begin);
        let target = children(actor, "plugin").find_map(|p| child(p, "target"));
        if let Some(target) = target {
            match numbers::<f32>(content(target)).as_deref() {
                Ok([x, y, ..]) => path.push(Vec2::new(*x, *y)),
                _ => return Err(format!("<target> holds '{}', not a point", content(target))),
            }
        }
    }
    Walker::new(path, round, speed, f64::from(RADIUS), f64::from(HEIGHT)).map_err(|e| e.to_string())
}

/// The place on the floor below.
fn flat(pose: DMat4) -> Vec2 {
    pose.w_axis.truncate().as_vec3().truncate()
}
