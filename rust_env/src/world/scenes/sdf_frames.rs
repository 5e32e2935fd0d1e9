//! SDF's poses: their spellings, the named frames they may be relative to, and `<state>`, which overrides them.
use std::collections::{HashMap, HashSet};

use glam::{DMat4, DQuat, DVec3, EulerRot};
use roxmltree::Node;

use super::text::{child, children, content, elements, numbers};
use super::MAX_DEPTH;

type Result<T> = std::result::Result<T, String>;

/// The `<pose>` of an element as written: x y z and fixed-axis roll pitch yaw, R = Rz(yaw) Ry(pitch) Rx(roll).
pub(super) fn pose(element: Node) -> Result<DMat4> {
    child(element, "pose").map_or(Ok(DMat4::IDENTITY), parse)
}

fn parse(pose: Node) -> Result<DMat4> {
    let text = content(pose);
    let values =
        numbers::<f64>(text).map_err(|word| format!("<pose> holds '{word}', not a number"))?;
    if values.iter().any(|v| !v.is_finite()) {
        return Err(format!("<pose>{text}</pose> is not finite"));
    }
    let quaternion = pose.attribute("rotation_format") == Some("quat_xyzw");
    let degrees = matches!(pose.attribute("degrees"), Some("true" | "1"));
    let (translation, rotation) = match values[..] {
        [] => return Ok(DMat4::IDENTITY),
        [x, y, z, qx, qy, qz, qw] if quaternion => {
            let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
            if rotation.length_squared() < 1e-12 {
                return Err(format!("<pose>{text}</pose> has a quaternion of length 0"));
            }
            (DVec3::new(x, y, z), rotation.normalize())
        }
        [x, y, z, roll, pitch, yaw] if !quaternion => {
            let angle = |a: f64| if degrees { a.to_radians() } else { a };
            let (roll, pitch, yaw) = (angle(roll), angle(pitch), angle(yaw));
            let rotation = DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll);
            (DVec3::new(x, y, z), rotation)
        }
        _ => return Err(format!("<pose>{text}</pose> has {} numbers", values.len())),
    };
    Ok(DMat4::from_rotation_translation(rotation, translation))
}

/// The named frames of a `<model>` or `<world>`.
pub(super) struct Frames<'a, 'i>(HashMap<&'a str, Node<'a, 'i>>);

impl<'a, 'i: 'a> Frames<'a, 'i> {
    pub fn of(scope: Node<'a, 'i>) -> Self {
        let mut named = HashMap::new();
        for element in elements(scope) {
            let name = match element.tag_name().name() {
                "link" | "frame" | "joint" | "model" => element.attribute("name"),
                "include" => child(element, "name").map(content),
                _ => None,
            };
            if let Some(name) = name {
                named.entry(name).or_insert(element);
            }
        }
        Self(named)
    }

    /// `scope_from_element`, where `default` is the frame of a pose that names none.
    pub fn place(&self, element: Node, default: DMat4) -> Result<DMat4> {
        self.place_at(element, default, 0)
    }

    /// `scope_from_frame` of a named frame.
    pub fn get(&self, name: &str) -> Result<DMat4> {
        self.get_at(name, 0)
    }

    fn place_at(&self, element: Node, default: DMat4, depth: usize) -> Result<DMat4> {
        let relative = child(element, "pose")
            .and_then(|p| p.attribute("relative_to").or(p.attribute("frame")))
            .filter(|name| !name.is_empty());
        let base = match relative {
            Some(name) => self.get_at(name, depth + 1)?,
            None => default,
        };
        Ok(base * pose(element)?)
    }

    fn get_at(&self, name: &str, depth: usize) -> Result<DMat4> {
        if name == "__model__" || name == "world" {
            return Ok(DMat4::IDENTITY);
        }
        if depth > MAX_DEPTH {
            return Err(format!("frame '{name}' is defined by itself"));
        }
        let element = *self
            .0
            .get(name)
            .ok_or_else(|| format!("no frame '{name}'"))?;
        // A frame stands where it is attached, a joint at its child link; everything else in the scope.
        let default = match element.tag_name().name() {
            "frame" => element.attribute("attached_to").filter(|n| !n.is_empty()),
            "joint" => child(element, "child").map(content),
            _ => None,
        };
        let default = match default {
            Some(name) => self.get_at(name, depth + 1)?,
            None => DMat4::IDENTITY,
        };
        self.place_at(element, default, depth)
    }
}

/// What `<state>` says of a model; worlds that Gazebo saved keep the poses of that moment there, in the world frame.
pub(super) struct ModelState {
    pub world_from_model: DMat4,
    pub scale: DVec3,
    pub world_from_link: HashMap<String, DMat4>,
}

/// The last `<state>` of a world. Nested models go by `outer::inner`.
#[derive(Default)]
pub(super) struct State {
    pub models: HashMap<String, ModelState>,
    pub deleted: HashSet<String>,
}

impl State {
    /// Returns the elements of models that were inserted while the world ran, too.
    pub fn read<'a, 'i: 'a>(world: Node<'a, 'i>) -> Result<(Self, Vec<Node<'a, 'i>>)> {
        let mut state = Self::default();
        let mut inserted = Vec::new();
        let Some(element) = children(world, "state").last() else {
            return Ok((state, inserted));
        };
        for model in children(element, "model") {
            state.model(model, "", 0)?;
        }
        for insertions in children(element, "insertions") {
            inserted.extend(children(insertions, "model"));
        }
        for deletions in children(element, "deletions") {
            let names = children(deletions, "name").map(|n| content(n).to_owned());
            state.deleted.extend(names);
        }
        Ok((state, inserted))
    }

    fn model(&mut self, element: Node, prefix: &str, depth: usize) -> Result<()> {
        let name = scoped(prefix, element.attribute("name").unwrap_or(""));
        if depth > MAX_DEPTH {
            return Err(format!("more than {MAX_DEPTH} nested models in '{name}'"));
        }
        for nested in children(element, "model") {
            self.model(nested, &name, depth + 1)?;
        }
        let world_from_link = children(element, "link")
            .filter(|link| child(*link, "pose").is_some())
            .map(|link| {
                let name = link.attribute("name").unwrap_or("").to_owned();
                Ok((name, pose(link)?))
            })
            .collect::<Result<_>>()?;
        let scale = match child(element, "scale") {
            Some(scale) => vector(scale)?,
            None => DVec3::ONE,
        };
        if child(element, "pose").is_some() {
            let state = ModelState {
                world_from_model: pose(element)?,
                scale,
                world_from_link,
            };
            self.models.insert(name, state);
        }
        Ok(())
    }
}

/// The name of an element inside a scope.
pub(super) fn scoped(prefix: &str, name: &str) -> String {
    if prefix.is_empty() {
        name.to_owned()
    } else {
        format!("{prefix}::{name}")
    }
}

/// Three finite numbers.
pub(super) fn vector(element: Node) -> Result<DVec3> {
    let text = content(element);
    match numbers::<f64>(text).as_deref() {
        Ok([x, y, z]) if x.is_finite() && y.is_finite() && z.is_finite() => {
            Ok(DVec3::new(*x, *y, *z))
        }
        _ => Err(format!(
            "<{0}>{text}</{0}> is not three finite numbers",
            element.tag_name().name()
        )),
    }
}
