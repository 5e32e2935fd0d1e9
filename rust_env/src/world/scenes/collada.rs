//! COLLADA (.dae): the triangles of the visual scene, in metres. Own reader: no crate follows Gazebo's reading of it.
//!
//! Ids are looked up per element type, since exporters give a node and its scene the same id. `<up_axis>` is ignored
//! unless asked for, as in Gazebo. Lines, materials, normals, cameras and animations are skipped.
use std::collections::HashMap;
use std::path::Path;
use std::rc::Rc;

use glam::{DMat4, DQuat, DVec3};
use roxmltree::{Document, Node, NodeId};

use super::collada_faces::{Faces, Kind};
use super::part::{z_up_from, Part};
use super::text::{self, child, children, content, elements, line};
use super::{LoadOptions, UpAxis, MAX_DEPTH, MAX_NODES};
use crate::error::{Error, Result};

const MAX_NOTES: usize = 100;

/// Reads all triangles of the scene. Warnings are appended to `notes`.
pub(super) fn read(
    path: &Path,
    bytes: Vec<u8>,
    options: &LoadOptions,
    notes: &mut Vec<String>,
) -> Result<Part> {
    let xml = text::Xml::new(path, bytes)?;
    for mended in &xml.mended {
        notes.push(format!("{}: {mended}", path.display()));
    }
    let document = xml.parse(path)?;
    let root = document.root_element();
    if root.tag_name().name() != "COLLADA" {
        return Err(Error::malformed(
            path,
            format!("root element <{}> is not <COLLADA>", root.tag_name().name()),
        ));
    }
    let mut reader = Reader {
        path,
        max_triangles: options.max_triangles,
        ids: Ids::new(&document),
        geometries: HashMap::new(),
        part: Part::default(),
        visits: 0,
        notes,
    };
    let world = reader.asset(root, options)?;
    match reader.visual_scene(root) {
        Some(scene) => reader.node(scene, world, 0)?,
        None => {
            reader.note(|| "no <visual_scene>, all geometries are placed at the origin".to_owned());
            for library in children(root, "library_geometries") {
                for geometry in children(library, "geometry") {
                    reader.place(geometry, world)?;
                }
            }
        }
    }
    Ok(reader.part)
}

/// First element with an id, per element type; in files of the wild an id is shared between types.
struct Ids<'a, 'i>(HashMap<(&'a str, &'a str), Node<'a, 'i>>);

impl<'a, 'i> Ids<'a, 'i> {
    fn new(document: &'a Document<'i>) -> Self {
        let mut ids = HashMap::new();
        for node in document.descendants().filter(Node::is_element) {
            if let Some(id) = node.attribute("id") {
                ids.entry((node.tag_name().name(), id)).or_insert(node);
            }
        }
        Self(ids)
    }

    fn get(&self, element: &'static str, url: &str) -> Option<Node<'a, 'i>> {
        self.0
            .get(&(element, url.strip_prefix('#').unwrap_or(url)))
            .copied()
    }
}

struct Reader<'a, 'i, 'n> {
    path: &'a Path,
    max_triangles: usize,
    ids: Ids<'a, 'i>,
    geometries: HashMap<NodeId, Rc<Part>>,
    part: Part,
    visits: usize,
    notes: &'n mut Vec<String>,
}

impl<'a, 'i> Reader<'a, 'i, '_> {
    fn error(&self, node: Node, message: impl std::fmt::Display) -> Error {
        let id = node
            .ancestors()
            .find_map(|n| n.attribute("id"))
            .unwrap_or("");
        Error::malformed(
            self.path,
            format!(
                "line {}, <{}> in '{id}': {message}",
                line(node),
                node.tag_name().name()
            ),
        )
    }

    /// The message is made only if it is kept: to name a line takes time in a large file.
    fn note(&mut self, message: impl FnOnce() -> String) {
        if self.notes.len() < MAX_NOTES {
            self.notes
                .push(format!("{}: {}", self.path.display(), message()));
        }
    }

    /// The file's unit and, if wanted, its up axis.
    fn asset(&mut self, root: Node, options: &LoadOptions) -> Result<DMat4> {
        let asset = child(root, "asset");
        let mut meter = 1.0;
        if let Some(unit) = asset.and_then(|a| child(a, "unit")) {
            let value = unit.attribute("meter").unwrap_or("1");
            meter = match value.trim().parse::<f64>() {
                Ok(meter) if meter.is_finite() && meter > 0.0 => meter,
                _ => return Err(self.error(unit, format!("meter=\"{value}\" is no length"))),
            };
        }
        let up = match asset.and_then(|a| child(a, "up_axis")).map(content) {
            Some("X_UP") => UpAxis::X,
            Some("Z_UP") => UpAxis::Z,
            _ => UpAxis::Y,
        };
        // Without a tag the format says y, but nobody means it.
        let tagged = asset.and_then(|a| child(a, "up_axis")).is_some();
        let scale = DMat4::from_scale(DVec3::splat(meter));
        if options.honour_up_axis && tagged {
            Ok(z_up_from(up) * scale)
        } else {
            Ok(scale)
        }
    }

    fn visual_scene(&self, root: Node<'a, 'i>) -> Option<Node<'a, 'i>> {
        child(root, "scene")
            .and_then(|s| child(s, "instance_visual_scene"))
            .and_then(|s| self.ids.get("visual_scene", s.attribute("url")?))
            .or_else(|| {
                children(root, "library_visual_scenes")
                    .find_map(|library| child(library, "visual_scene"))
            })
    }

    /// A `<node>` or the `<visual_scene>` itself, whose children are nodes.
    fn node(&mut self, node: Node<'a, 'i>, parent: DMat4, depth: usize) -> Result<()> {
        self.visits += 1;
        if depth > MAX_DEPTH || self.visits > MAX_NODES {
            return Err(self.error(
                node,
                format!("more than {MAX_DEPTH} levels or {MAX_NODES} nodes"),
            ));
        }
        let mut world = parent;
        for element in elements(node) {
            if let Some(transform) = self.transform(element)? {
                world *= transform;
            }
        }
        if !world.is_finite() {
            return Err(self.error(node, "the transform is not finite"));
        }
        for element in elements(node) {
            let name = element.tag_name().name();
            let url = element.attribute("url").unwrap_or("");
            match name {
                "node" => self.node(element, world, depth + 1)?,
                "instance_node" => match self.ids.get("node", url) {
                    Some(target) => self.node(target, world, depth + 1)?,
                    None => return Err(self.error(element, format!("no node '{url}'"))),
                },
                "instance_geometry" => match self.ids.get("geometry", url) {
                    Some(geometry) => self.place(geometry, world)?,
                    None => return Err(self.error(element, format!("no geometry '{url}'"))),
                },
                "instance_controller" => self.controller(element, url, world)?,
                _ => {}
            }
        }
        Ok(())
    }

    /// A skinned mesh in its bind pose.
    fn controller(&mut self, element: Node<'a, 'i>, url: &str, world: DMat4) -> Result<()> {
        let skin = self
            .ids
            .get("controller", url)
            .and_then(|c| child(c, "skin"));
        let Some((skin, geometry)) = skin.and_then(|s| {
            let source = s.attribute("source")?;
            Some((s, self.ids.get("geometry", source)?))
        }) else {
            return Err(self.error(element, format!("no skinned geometry behind '{url}'")));
        };
        let bind = match child(skin, "bind_shape_matrix") {
            Some(matrix) => self.matrix(matrix)?,
            None => DMat4::IDENTITY,
        };
        self.place(geometry, world * bind)
    }

    fn floats<const N: usize>(&self, element: Node) -> Result<[f64; N]> {
        let values = text::numbers::<f64>(content(element))
            .map_err(|word| self.error(element, format!("'{word}' is not a number")))?;
        values
            .try_into()
            .map_err(|v: Vec<f64>| self.error(element, format!("{} numbers, not {N}", v.len())))
    }

    fn matrix(&self, element: Node) -> Result<DMat4> {
        Ok(DMat4::from_cols_array(&self.floats::<16>(element)?).transpose())
    }

    fn transform(&mut self, element: Node) -> Result<Option<DMat4>> {
        Ok(Some(match element.tag_name().name() {
            "matrix" => self.matrix(element)?,
            "translate" => DMat4::from_translation(self.floats::<3>(element)?.into()),
            "scale" => DMat4::from_scale(self.floats::<3>(element)?.into()),
            "rotate" => {
                let [x, y, z, degrees] = self.floats::<4>(element)?;
                match DVec3::new(x, y, z).try_normalize() {
                    Some(axis) => {
                        DMat4::from_quat(DQuat::from_axis_angle(axis, degrees.to_radians()))
                    }
                    None => DMat4::IDENTITY,
                }
            }
            name @ ("lookat" | "skew") => {
                self.note(|| format!("line {}, <{name}> is not supported", line(element)));
                return Ok(None);
            }
            _ => return Ok(None),
        }))
    }

    fn place(&mut self, node: Node<'a, 'i>, world: DMat4) -> Result<()> {
        self.visits += 1;
        let geometry = match self.geometries.get(&node.id()) {
            Some(geometry) => geometry.clone(),
            None => {
                let geometry = Rc::new(self.geometry(node)?);
                self.geometries.insert(node.id(), geometry.clone());
                geometry
            }
        };
        self.part
            .append(&geometry, world, self.max_triangles)
            .map_err(|message| self.error(node, message))
    }

    fn geometry(&mut self, node: Node<'a, 'i>) -> Result<Part> {
        let mut geometry = Part::default();
        let Some(mesh) = child(node, "mesh") else {
            self.note(|| format!("line {}, <geometry> without <mesh> was skipped", line(node)));
            return Ok(geometry);
        };
        // Several primitives share one position source as a rule.
        let mut sources: Vec<(NodeId, u32, u32)> = Vec::new();
        for primitive in elements(mesh) {
            let Some(kind) = Kind::of(primitive) else {
                continue;
            };
            let Some((stride, offset, source)) = self.positions_of(mesh, primitive)? else {
                continue;
            };
            let (base, count) = match sources.iter().find(|s| s.0 == source.id()) {
                Some(&(_, base, count)) => (base, count),
                None => {
                    let base = geometry.vertices.len() as u32;
                    self.positions(source, &mut geometry.vertices)?;
                    let count = geometry.vertices.len() as u32 - base;
                    sources.push((source.id(), base, count));
                    (base, count)
                }
            };
            let faces = Faces {
                kind,
                stride,
                offset,
                base,
                count,
            };
            faces
                .read(primitive, &mut geometry, self.max_triangles)
                .map_err(|message| self.error(primitive, message))?;
        }
        Ok(geometry)
    }

    /// Of a primitive: numbers per vertex, place of the position index among them, and the position `<source>`.
    /// None if the primitive is empty, as exporters leave some without any input.
    fn positions_of(
        &self,
        mesh: Node<'a, 'i>,
        primitive: Node<'a, 'i>,
    ) -> Result<Option<(usize, usize, Node<'a, 'i>)>> {
        let mut stride = 0;
        let mut vertex = None;
        for input in children(primitive, "input") {
            let text = input.attribute("offset").unwrap_or("0");
            let offset: usize = text
                .trim()
                .parse()
                .ok()
                .filter(|&o| o < 64)
                .ok_or_else(|| self.error(input, format!("offset=\"{text}\"")))?;
            stride = stride.max(offset + 1);
            if input.attribute("semantic") == Some("VERTEX") {
                vertex = Some((offset, input));
            }
        }
        let Some((offset, input)) = vertex else {
            let indices = primitive.descendants().filter(|n| n.has_tag_name("p"));
            if indices.map(content).all(str::is_empty) {
                return Ok(None);
            }
            return Err(self.error(primitive, "no input with semantic=\"VERTEX\""));
        };
        let url = input.attribute("source").unwrap_or("");
        let find = |name: &'static str, url: &str| {
            let id = url.strip_prefix('#').unwrap_or(url);
            let near = children(mesh, name).find(|n| n.attribute("id") == Some(id));
            near.or_else(|| self.ids.get(name, url))
        };
        let vertices = find("vertices", url)
            .ok_or_else(|| self.error(input, format!("no <vertices> '{url}'")))?;
        let source = children(vertices, "input")
            .find(|i| i.attribute("semantic") == Some("POSITION"))
            .and_then(|i| find("source", i.attribute("source")?))
            .ok_or_else(|| self.error(vertices, "no position source"))?;
        Ok(Some((stride, offset, source)))
    }

    fn positions(&self, source: Node<'a, 'i>, out: &mut Vec<DVec3>) -> Result<()> {
        let array =
            child(source, "float_array").ok_or_else(|| self.error(source, "no <float_array>"))?;
        let accessor = child(source, "technique_common").and_then(|t| child(t, "accessor"));
        let number = |name, default: usize| match accessor.and_then(|a| a.attribute(name)) {
            Some(text) => text
                .trim()
                .parse()
                .map_err(|_| self.error(source, format!("accessor {name}=\"{text}\""))),
            None => Ok(default),
        };
        let (stride, offset) = (number("stride", 3)?, number("offset", 0)?);
        if !(3..=64).contains(&stride) {
            return Err(self.error(source, format!("accessor stride=\"{stride}\"")));
        }
        let values = text::numbers::<f64>(content(array))
            .map_err(|word| self.error(array, format!("'{word}' is not a number")))?;
        let available = values.len().saturating_sub(offset) / stride;
        let count = number("count", available)?;
        if count > available {
            return Err(self.error(
                source,
                format!("accessor count=\"{count}\", but the array holds {available}"),
            ));
        }
        let start = offset.min(values.len());
        for value in values[start..].chunks_exact(stride).take(count) {
            let vertex = DVec3::new(value[0], value[1], value[2]);
            if !vertex.is_finite() {
                return Err(self.error(array, format!("vertex {vertex} is not finite")));
            }
            out.push(vertex);
        }
        Ok(())
    }
}
