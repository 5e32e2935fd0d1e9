//! The geometry of a `<visual>` or `<collision>`: simple shapes, planes and meshes.
use std::path::Path;
use std::rc::Rc;

use glam::{DMat4, DQuat, DVec3};
use roxmltree::Node;

use super::assembly::{finite, Layer};
use super::part::Part;
use super::sdf::{Link, Walk};
use super::sdf_frames::vector;
use super::text::{child, content, elements, line, numbers};
use super::{disk, mesh_file, primitives};
use crate::error::Result;

/// A horizontal plane at least this wide is a ground plane, metres; smaller ones are rugs.
const GROUND_SIZE: f64 = 20.0;
/// A plane is horizontal if the z of its unit normal is at least this.
const HORIZONTAL: f64 = 0.9999;

impl Walk<'_, '_> {
    /// Places the geometry of a `<visual>` or `<collision>`; false if it was lost.
    pub(super) fn shape(&mut self, link: &Link, element: Node, layer: Layer) -> Result<bool> {
        self.visit(link.file, element)?;
        let world = match child(element, "pose") {
            // Relative to the link, or to a frame of the model.
            Some(pose) => {
                let names = [pose.attribute("relative_to"), pose.attribute("frame")];
                let named = names.into_iter().flatten().any(|name| !name.is_empty());
                let base = if named {
                    link.world_from_model
                } else {
                    link.world_from_link
                };
                match link.frames.place(element, DMat4::IDENTITY) {
                    Ok(pose) => base * pose,
                    Err(message) => return self.loss(link.file, element, message).map(|_| false),
                }
            }
            None => link.world_from_link,
        };
        let what = || {
            format!(
                "model '{}', line {}, <{} name='{}'>",
                link.model,
                line(element),
                element.tag_name().name(),
                element.attribute("name").unwrap_or("")
            )
        };
        let Some(shape) = child(element, "geometry").and_then(|g| elements(g).next()) else {
            return Ok(true);
        };
        let world = match finite(world * DMat4::from_scale(link.scale), link.file, &what) {
            Ok(world) => world,
            Err(error) => return self.assembly.loss(error).map(|_| false),
        };
        let mesh = match shape.tag_name().name() {
            "empty" => return Ok(true),
            "plane" => {
                let placed = match plane(shape) {
                    Ok(plane) => self.plane(&plane, world, layer, link.file, &what)?,
                    Err(message) => return self.loss(link.file, element, message).map(|_| false),
                };
                return Ok(placed);
            }
            "mesh" => {
                let scale = match child(shape, "scale").map(vector).transpose() {
                    Ok(scale) => scale.unwrap_or(DVec3::ONE),
                    Err(message) => return self.loss(link.file, element, message).map(|_| false),
                };
                if let Some(submesh) = child(shape, "submesh") {
                    let name = child(submesh, "name").map_or("", content);
                    let message = format!("<submesh> '{name}' is not supported");
                    return self.loss(link.file, element, message).map(|_| false);
                }
                let uri = child(shape, "uri").map_or("", content);
                let Some(mesh) = self.mesh(uri, element, link.file)? else {
                    return Ok(false);
                };
                let world = world * DMat4::from_scale(scale);
                self.assembly.place(layer, &mesh, world, link.file, &what)?;
                return Ok(true);
            }
            _ => primitive(shape),
        };
        match mesh {
            Ok(mesh) => {
                self.assembly.place(layer, &mesh, world, link.file, &what)?;
                Ok(true)
            }
            Err(message) => self.loss(link.file, element, message).map(|_| false),
        }
    }

    fn plane(
        &mut self,
        plane: &Plane,
        world: DMat4,
        layer: Layer,
        file: &Path,
        what: &dyn Fn() -> String,
    ) -> Result<bool> {
        let normal = world.transform_vector3(plane.normal).normalize_or_zero();
        let infinite = layer == Layer::Collision || plane.size[0].min(plane.size[1]) >= GROUND_SIZE;
        if infinite && normal.z >= HORIZONTAL {
            self.assembly.place_plane(layer, world.w_axis.z);
        } else {
            let turn = DQuat::from_rotation_arc(DVec3::Z, plane.normal);
            let mesh = primitives::rectangle(plane.size[0], plane.size[1]);
            let world = world * DMat4::from_quat(turn);
            self.assembly.place(layer, &mesh, world, file, what)?;
        }
        Ok(true)
    }

    /// The mesh behind a URI, read once.
    fn mesh(&mut self, uri: &str, node: Node, file: &Path) -> Result<Option<Rc<Part>>> {
        let Some(path) = self.find(uri, node, file)?.filter(|p| disk::is_file(p)) else {
            self.assembly.miss(file, uri, "mesh not found")?;
            return Ok(None);
        };
        let read = match self.meshes.get(&path) {
            Some(read) => read.clone(),
            None => {
                let mut notes = Vec::new();
                let read = mesh_file::read(&path, self.assembly.options, &mut notes)
                    .map(Rc::new)
                    .map_err(|error| error.to_string());
                notes.into_iter().for_each(|note| self.assembly.note(note));
                if let Ok(mesh) = &read {
                    self.mesh_triangles += mesh.triangles.len();
                }
                if self.mesh_triangles > self.assembly.options.max_triangles {
                    let limit = self.assembly.options.max_triangles;
                    return Err(self.error(file, node, format!("more than {limit} triangles")));
                }
                self.meshes.insert(path, read.clone());
                read
            }
        };
        match read {
            Ok(mesh) => Ok(Some(mesh)),
            Err(message) => self.assembly.miss(file, uri, &message).map(|_| None),
        }
    }
}

struct Plane {
    normal: DVec3,
    size: [f64; 2],
}

fn plane(shape: Node) -> std::result::Result<Plane, String> {
    let normal = child(shape, "normal").map_or(Ok(DVec3::Z), vector)?;
    let normal = normal
        .try_normalize()
        .ok_or("a <plane> with a normal of length 0")?;
    let size = match child(shape, "size") {
        Some(size) => match numbers::<f64>(content(size)).as_deref() {
            Ok([x, y]) if x.is_finite() && y.is_finite() && *x >= 0.0 && *y >= 0.0 => [*x, *y],
            _ => return Err(format!("<plane> of <size>{}</size>", content(size))),
        },
        None => [1.0; 2],
    };
    Ok(Plane { normal, size })
}

fn primitive(shape: Node) -> std::result::Result<Part, String> {
    let name = shape.tag_name().name();
    let length = |of: &'static str| -> std::result::Result<f64, String> {
        let text = child(shape, of).map_or("", content);
        text.parse()
            .ok()
            .filter(|v: &f64| v.is_finite() && *v >= 0.0)
            .ok_or_else(|| format!("<{name}> has <{of}>{text}</{of}>, not a length"))
    };
    let lengths = |of: &'static str| {
        child(shape, of)
            .ok_or_else(|| format!("<{name}> without <{of}>"))
            .and_then(vector)
            .map(|v| v.abs())
    };
    Ok(match name {
        "box" => primitives::cuboid(lengths("size")?),
        "cylinder" => primitives::cylinder(length("radius")?, length("length")?),
        "cone" => primitives::cone(length("radius")?, length("length")?),
        "sphere" => primitives::ellipsoid(DVec3::splat(length("radius")?)),
        "capsule" => primitives::capsule(length("radius")?, length("length")?),
        "ellipsoid" => primitives::ellipsoid(lengths("radii")?),
        _ => return Err(format!("<{name}> is not supported")),
    })
}
