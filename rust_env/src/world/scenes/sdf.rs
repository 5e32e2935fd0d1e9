//! SDF worlds and models: which meshes and simple shapes stand where.
//!
//! T = parent model * (pose of the include, or else of the included model) * nested model * link * visual or
//! collision * mesh scale, in f64. Lights, physics, plugins, materials and joints do not matter here.
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use glam::{DMat4, DQuat, DVec3};
use roxmltree::Node;

use super::assembly::{finite, Assembly, Layer};
use super::part::Part;
use super::resources::{sdf_of_model, Found, Resources};
use super::sdf_frames::{scoped, vector, Frames, State};
use super::text::{child, children, content, elements, line, Xml};
use super::{mesh_file, primitives, MAX_DEPTH, MAX_FILE_BYTES, MAX_NODES};
use crate::error::{Error, Result};

/// A horizontal plane at least this wide is a ground plane, metres; smaller ones are rugs.
const GROUND_SIZE: f64 = 20.0;
/// A plane is horizontal if the z of its unit normal is at least this.
const HORIZONTAL: f64 = 0.9999;

/// Reads a `.world` or `.sdf` file. A broken file, or nothing to place in it, is an error.
pub(super) fn read(path: &Path, assembly: &mut Assembly) -> Result<()> {
    let resources = Resources::new(path, &assembly.options.search_paths);
    let mut walk = Walk {
        resources,
        assembly,
        meshes: HashMap::new(),
        mesh_triangles: 0,
        xml_bytes: 0,
        visits: 0,
    };
    let xml = walk.xml(path)?;
    let document = xml.parse(path)?;
    let root = document.root_element();
    let scope = Scope {
        file: path,
        world_from_scope: DMat4::IDENTITY,
        prefix: "",
        state: &State::default(),
        depth: 0,
    };
    match child(root, "world") {
        Some(world) => {
            if children(root, "world").count() > 1 {
                walk.note(path, root, "only the first of several worlds is read");
            }
            walk.world(world, path)
        }
        None => walk.children(root, &scope),
    }
}

/// Where the elements being read belong.
#[derive(Clone, Copy)]
struct Scope<'s> {
    file: &'s Path,
    world_from_scope: DMat4,
    /// Names of the models around, joined by `::`.
    prefix: &'s str,
    state: &'s State,
    depth: usize,
}

/// What an `<include>` says of the model it includes.
#[derive(Default)]
struct Included<'s> {
    name: Option<&'s str>,
    scope_from_model: Option<DMat4>,
    placement_frame: Option<&'s str>,
}

struct Walk<'w, 'o> {
    resources: Resources,
    assembly: &'w mut Assembly<'o>,
    /// Read meshes, or why one could not be read.
    meshes: HashMap<PathBuf, std::result::Result<Rc<Part>, String>>,
    mesh_triangles: usize,
    xml_bytes: u64,
    visits: usize,
}

impl Walk<'_, '_> {
    fn error(&self, file: &Path, node: Node, message: impl std::fmt::Display) -> Error {
        let name = node.attribute("name").unwrap_or("");
        let tag = node.tag_name().name();
        let text = format!("line {}, <{tag} name='{name}'>: {message}", line(node));
        Error::malformed(file, text)
    }

    fn note(&mut self, file: &Path, node: Node, message: &str) {
        let text = self.error(file, node, message).to_string();
        self.assembly.note(text);
    }

    fn loss(&mut self, file: &Path, node: Node, message: impl std::fmt::Display) -> Result<()> {
        let error = self.error(file, node, message);
        self.assembly.loss(error)
    }

    /// Reads an XML file; included ones are read anew each time, so the sum is capped, not only each.
    fn xml(&mut self, path: &Path) -> Result<Xml> {
        let xml = Xml::read(path)?;
        self.xml_bytes += xml.len();
        if self.xml_bytes > MAX_FILE_BYTES {
            return Err(Error::malformed(
                path,
                format!("more than {MAX_FILE_BYTES} bytes of SDF are included"),
            ));
        }
        if let Some(mended) = xml.mended {
            self.assembly.note(format!("{}: {mended}", path.display()));
        }
        Ok(xml)
    }

    fn visit(&mut self, file: &Path, node: Node) -> Result<()> {
        self.visits += 1;
        if self.visits > MAX_NODES {
            return Err(self.error(file, node, format!("more than {MAX_NODES} elements")));
        }
        Ok(())
    }

    fn world(&mut self, world: Node, file: &Path) -> Result<()> {
        let (state, inserted) = match State::read(world) {
            Ok(read) => read,
            Err(message) => {
                self.loss(file, world, message)?;
                Default::default()
            }
        };
        let scope = Scope {
            file,
            world_from_scope: DMat4::IDENTITY,
            prefix: "",
            state: &state,
            depth: 0,
        };
        self.children(world, &scope)?;
        let frames = Frames::of(world);
        for model in inserted {
            self.model(model, &scope, &frames, Included::default())?;
        }
        Ok(())
    }

    /// The models, includes and links of a `<world>`, `<model>` or `<sdf>`.
    fn children(&mut self, parent: Node, scope: &Scope) -> Result<()> {
        let frames = Frames::of(parent);
        for element in elements(parent) {
            match element.tag_name().name() {
                "model" => self.model(element, scope, &frames, Included::default())?,
                "include" => self.include(element, scope, &frames)?,
                "actor" => self.assembly.note(format!(
                    "{}: an <actor> was left out, people are no part of the static scene",
                    scope.file.display()
                )),
                name @ ("population" | "road") => {
                    self.loss(scope.file, element, format!("<{name}> is not supported"))?
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn include(&mut self, include: Node, scope: &Scope, frames: &Frames) -> Result<()> {
        self.visit(scope.file, include)?;
        let Some(uri) = child(include, "uri").map(content).filter(|u| !u.is_empty()) else {
            return self.loss(scope.file, include, "no <uri>");
        };
        let scope_from_model = match child(include, "pose") {
            Some(_) => match frames.place(include, DMat4::IDENTITY) {
                Ok(pose) => Some(pose),
                Err(message) => return self.loss(scope.file, include, message),
            },
            None => None,
        };
        let Some(found) = self.find(uri, include, scope.file)? else {
            return self.built_in(uri, scope_from_model, include, scope);
        };
        let sdf = if found.is_dir() {
            sdf_of_model(&found)
        } else {
            Some(found)
        };
        let Some(sdf) = sdf else {
            return self
                .assembly
                .miss(scope.file, uri, "the folder holds no SDF file");
        };
        if scope.depth >= MAX_DEPTH {
            return self.loss(
                scope.file,
                include,
                format!("more than {MAX_DEPTH} levels of includes"),
            );
        }
        let xml = match self.xml(&sdf) {
            Ok(xml) => xml,
            Err(error) => return self.assembly.miss(scope.file, uri, &error.to_string()),
        };
        let document = match xml.parse(&sdf) {
            Ok(document) => document,
            Err(error) => return self.assembly.miss(scope.file, uri, &error.to_string()),
        };
        let root = document.root_element();
        let inner = Scope {
            file: &sdf,
            depth: scope.depth + 1,
            ..*scope
        };
        let model = match root.tag_name().name() {
            "model" => Some(root),
            _ => child(root, "model"),
        };
        if let Some(model) = model {
            let included = Included {
                name: child(include, "name").map(content),
                scope_from_model,
                placement_frame: child(include, "placement_frame").map(content),
            };
            // Frames of the including file mean nothing to the included one.
            return self.model(model, &inner, &Frames::of(root), included);
        }
        if child(root, "actor").is_some() || child(root, "light").is_some() {
            return Ok(());
        }
        self.assembly
            .miss(scope.file, uri, "the SDF file holds no model")
    }

    /// The two models that every world includes are known even where Gazebo's model folder is not installed.
    fn built_in(
        &mut self,
        uri: &str,
        scope_from_model: Option<DMat4>,
        include: Node,
        scope: &Scope,
    ) -> Result<()> {
        let name = uri
            .rsplit('/')
            .next()
            .unwrap_or("")
            .to_lowercase()
            .replace([' ', '_'], "");
        match name.as_str() {
            "sun" => Ok(()),
            "groundplane" => {
                let world = scope.world_from_scope * scope_from_model.unwrap_or(DMat4::IDENTITY);
                finite(world, scope.file, "ground plane")?;
                self.note(
                    scope.file,
                    include,
                    "model not found, the built-in ground plane is used",
                );
                for layer in [Layer::Visual, Layer::Collision] {
                    self.assembly.place_plane(layer, world.w_axis.z);
                }
                self.assembly.instances += 1;
                Ok(())
            }
            _ => self.assembly.miss(scope.file, uri, "not found"),
        }
    }

    /// The file or folder of a URI; None where it does not exist.
    fn find(&mut self, uri: &str, node: Node, file: &Path) -> Result<Option<PathBuf>> {
        let folder = file.parent().unwrap_or(Path::new(""));
        match self.resources.find(uri, folder) {
            Found::Exact(path) => Ok(Some(path)),
            Found::OtherCase(path) => {
                let message = format!("'{uri}' was found only as {}", path.display());
                self.note(file, node, &message);
                Ok(Some(path))
            }
            Found::Missing => Ok(None),
            Found::Refused => {
                self.note(
                    file,
                    node,
                    &format!("'{uri}' lies outside every search path"),
                );
                Ok(None)
            }
        }
    }

    fn model(
        &mut self,
        model: Node,
        scope: &Scope,
        around: &Frames,
        included: Included,
    ) -> Result<()> {
        self.visit(scope.file, model)?;
        let own = model.attribute("name").unwrap_or("");
        let name = scoped(scope.prefix, included.name.unwrap_or(own));
        if scope.state.deleted.contains(&name) {
            return Ok(());
        }
        if scope.depth >= MAX_DEPTH {
            return self.loss(
                scope.file,
                model,
                format!("more than {MAX_DEPTH} levels of models"),
            );
        }
        let frames = Frames::of(model);
        let state = scope.state.models.get(&name);
        let world_from_model = match state {
            Some(state) => Ok(state.world_from_model),
            None => included
                .scope_from_model
                .map_or_else(|| around.place(model, DMat4::IDENTITY), Ok)
                .and_then(|scope_from_model| {
                    let frame = included
                        .placement_frame
                        .or(model.attribute("placement_frame"));
                    let model_from_frame = match frame.filter(|name| !name.is_empty()) {
                        Some(name) => frames.get(name)?,
                        None => DMat4::IDENTITY,
                    };
                    Ok(scope.world_from_scope * scope_from_model * model_from_frame.inverse())
                }),
        };
        let world_from_model = match world_from_model {
            Ok(pose) => pose,
            Err(message) => return self.loss(scope.file, model, message),
        };
        let scale = state.map_or(DVec3::ONE, |state| state.scale);
        let mut solid = false;
        for link in children(model, "link") {
            self.visit(scope.file, link)?;
            let moved = state.and_then(|s| s.world_from_link.get(link.attribute("name")?));
            let world_from_link = match moved {
                Some(pose) => *pose,
                None => match frames.place(link, DMat4::IDENTITY) {
                    Ok(pose) => world_from_model * pose,
                    Err(message) => {
                        self.loss(scope.file, link, message)?;
                        continue;
                    }
                },
            };
            let link = Link {
                file: scope.file,
                world_from_model,
                world_from_link,
                frames: &frames,
                scale,
                model: &name,
                node: link,
            };
            solid |= self.link(&link)?;
        }
        self.assembly.instances += usize::from(solid);
        let inner = Scope {
            file: scope.file,
            world_from_scope: world_from_model,
            prefix: &name,
            state: scope.state,
            depth: scope.depth + 1,
        };
        self.children(model, &inner)
    }

    /// True if anything was placed.
    fn link(&mut self, link: &Link) -> Result<bool> {
        let mut lost = 0;
        let mut placed = false;
        for (layer, tag) in [(Layer::Visual, "visual"), (Layer::Collision, "collision")] {
            for element in children(link.node, tag) {
                match self.shape(link, element, layer)? {
                    true => placed = true,
                    false => lost += usize::from(layer == Layer::Visual),
                }
            }
        }
        // A body without a skin is still seen by the sensors of the real world.
        if lost > 0 && child(link.node, "collision").is_some() {
            self.note(
                link.file,
                link.node,
                &format!(
                    "model '{}': the collision shape stands in for a lost visual",
                    link.model
                ),
            );
            for element in children(link.node, "collision") {
                self.shape(link, element, Layer::Visual)?;
            }
        }
        Ok(placed)
    }

    /// Places the geometry of a `<visual>` or `<collision>`; false if it was lost.
    fn shape(&mut self, link: &Link, element: Node, layer: Layer) -> Result<bool> {
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
        let what = format!(
            "model '{}', line {}, <{} name='{}'>",
            link.model,
            line(element),
            element.tag_name().name(),
            element.attribute("name").unwrap_or("")
        );
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
        what: &str,
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
        let Some(path) = self.find(uri, node, file)?.filter(|p| p.is_file()) else {
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

struct Link<'l, 'a, 'i> {
    file: &'l Path,
    world_from_model: DMat4,
    world_from_link: DMat4,
    frames: &'l Frames<'a, 'i>,
    scale: DVec3,
    model: &'l str,
    node: Node<'a, 'i>,
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
        Some(size) => match super::text::numbers::<f64>(content(size)).as_deref() {
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
