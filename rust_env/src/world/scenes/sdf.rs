//! SDF worlds and models: which meshes and simple shapes stand where.
//!
//! T = parent model * (pose of the include, or else of the included model) * nested model * link * visual or
//! collision * mesh scale, in f64. Lights, physics, plugins, materials and joints do not matter here.
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use glam::{DMat4, DVec3};
use roxmltree::Node;

use super::assembly::{finite, Assembly, Layer};
use super::disk;
use super::part::Part;
use super::resources::{sdf_of_model, Found, Resources};
use super::sdf_actors;
use super::sdf_frames::{scoped, Frames, State};
use super::text::{child, children, content, elements, line, Xml};
use super::{MAX_DEPTH, MAX_NODES};
use crate::error::{Error, Result};
use crate::world::bodies::MAX_BODIES;

/// Includes, counted per visit: two files that include each other twice must not multiply without end.
const MAX_INCLUDES: usize = 100_000;
const MAX_INCLUDED_BYTES: u64 = 1 << 28;

/// Reads a `.world` or `.sdf` file. A broken file, or nothing to place in it, is an error.
pub(super) fn read(path: &Path, assembly: &mut Assembly) -> Result<()> {
    let resources = Resources::new(path, &assembly.options.search_paths);
    let mut walk = Walk {
        resources,
        assembly,
        meshes: HashMap::new(),
        mesh_triangles: 0,
        included_bytes: 0,
        visits: 0,
        includes: 0,
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

pub(super) struct Walk<'w, 'o> {
    resources: Resources,
    pub assembly: &'w mut Assembly<'o>,
    /// Read meshes, or why one could not be read.
    pub meshes: HashMap<PathBuf, std::result::Result<Rc<Part>, String>>,
    pub mesh_triangles: usize,
    included_bytes: u64,
    visits: usize,
    includes: usize,
}

impl Walk<'_, '_> {
    pub fn error(&self, file: &Path, node: Node, message: impl std::fmt::Display) -> Error {
        let name = node.attribute("name").unwrap_or("");
        let tag = node.tag_name().name();
        let text = format!("line {}, <{tag} name='{name}'>: {message}", line(node));
        Error::malformed(file, text)
    }

    pub fn note(&mut self, file: &Path, node: Node, message: &str) {
        if self.assembly.is_full() {
            self.assembly.more += 1;
            return;
        }
        let text = self.error(file, node, message).to_string();
        self.assembly.note(text);
    }

    pub fn loss(&mut self, file: &Path, node: Node, message: impl std::fmt::Display) -> Result<()> {
        if self.assembly.is_full() && !self.assembly.options.strict {
            self.assembly.more += 1;
            return Ok(());
        }
        let error = self.error(file, node, message);
        self.assembly.loss(error)
    }

    fn xml(&mut self, path: &Path) -> Result<Xml> {
        let xml = Xml::read(path)?;
        for mended in &xml.mended {
            self.assembly.note(format!("{}: {mended}", path.display()));
        }
        Ok(xml)
    }

    pub fn visit(&mut self, file: &Path, node: Node) -> Result<()> {
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
                "actor" => match sdf_actors::walker(element, &frames, scope.world_from_scope) {
                    Ok(walker) if self.assembly.actors.len() < MAX_BODIES => {
                        self.assembly.actors.push(walker)
                    }
                    Ok(_) => self.note(scope.file, element, "one actor too many, left out"),
                    Err(message) => self.note(scope.file, element, &format!("left out: {message}")),
                },
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
        self.includes += 1;
        if self.includes > MAX_INCLUDES {
            let message = format!("more than {MAX_INCLUDES} includes");
            return Err(self.error(scope.file, include, message));
        }
        let Some(found) = self.find(uri, include, scope.file)? else {
            return self.built_in(uri, scope_from_model, include, scope);
        };
        let sdf = if disk::is_folder(&found) {
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
        // An included file is read anew each time, so the sum is capped, not only each.
        self.included_bytes += xml.bytes() as u64;
        if self.included_bytes > MAX_INCLUDED_BYTES {
            let message = format!("more than {MAX_INCLUDED_BYTES} bytes are included");
            return Err(self.error(scope.file, include, message));
        }
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
                finite(world, scope.file, &|| "ground plane".to_owned())?;
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
    pub fn find(&mut self, uri: &str, node: Node, file: &Path) -> Result<Option<PathBuf>> {
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
}

pub(super) struct Link<'l, 'a, 'i> {
    pub file: &'l Path,
    pub world_from_model: DMat4,
    pub world_from_link: DMat4,
    pub frames: &'l Frames<'a, 'i>,
    pub scale: DVec3,
    pub model: &'l str,
    pub node: Node<'a, 'i>,
}
