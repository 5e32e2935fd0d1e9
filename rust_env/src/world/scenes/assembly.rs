//! A scene in the making: placed meshes, planes, warnings; and the limits that hold for the whole of it.
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::{DMat4, DVec3};

use super::clean::{self, Soup};
use super::part::Part;
use super::{LoadOptions, MAX_COORDINATE};
use crate::error::{Error, Result};
use crate::geometry::{Aabb, Mesh, Vec3};
use crate::interrupt;
use crate::world::bodies::Walker;
use crate::world::scene::{LoadReport, Scene};

/// How far the finite square of a ground plane reaches beyond everything else, metres.
const PLANE_MARGIN: f32 = 0.5;
/// Exploration reaches this far below and above the floor, metres.
const BELOW_FLOOR: f32 = 0.1;
const ABOVE_FLOOR: f32 = 3.5;
/// Distinct warnings that are kept.
const MAX_WARNINGS: usize = 500;
/// Warnings whose text is made, equal ones included.
const MAX_NOTED: usize = 2000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layer {
    /// What cameras see.
    Visual,
    /// What bodies hit.
    Collision,
}

pub(super) struct Assembly<'o> {
    pub options: &'o LoadOptions,
    pub instances: usize,
    /// The scene is one mesh, whose connected parts are its objects; otherwise each instance is one.
    pub lone: bool,
    pub actors: Vec<Walker>,
    /// Triangles as read, in each layer.
    read: [usize; 2],
    layers: [Soup; 2],
    /// Height of the ground plane in each layer.
    planes: [Option<f32>; 2],
    warnings: BTreeMap<String, usize>,
    noted: usize,
    pub more: usize,
    missing: BTreeSet<String>,
}

impl<'o> Assembly<'o> {
    pub fn new(options: &'o LoadOptions) -> Self {
        Self {
            options,
            instances: 0,
            lone: false,
            actors: Vec::new(),
            read: [0; 2],
            layers: Default::default(),
            planes: [None; 2],
            warnings: BTreeMap::new(),
            noted: 0,
            more: 0,
            missing: BTreeSet::new(),
        }
    }

    /// Something that was mended or ignored without loss of geometry.
    pub fn note(&mut self, message: impl Into<String>) {
        let message = message.into();
        self.noted += 1;
        if let Some(count) = self.warnings.get_mut(&message) {
            *count += 1;
        } else if self.is_full() {
            self.more += 1;
        } else {
            self.warnings.insert(message, 1);
        }
    }

    /// Further warnings are only counted; their texts need not be made, which takes time in a large file.
    pub fn is_full(&self) -> bool {
        self.warnings.len() >= MAX_WARNINGS || self.noted >= MAX_NOTED
    }

    /// Geometry is lost: an error under `strict`, else a warning.
    pub fn loss(&mut self, error: Error) -> Result<()> {
        if self.options.strict {
            return Err(error);
        }
        self.note(error.to_string());
        Ok(())
    }

    /// A model or mesh that is not there.
    pub fn miss(&mut self, file: &Path, uri: &str, message: &str) -> Result<()> {
        if self.missing.len() < MAX_WARNINGS {
            self.missing.insert(uri.to_owned());
        }
        self.loss(Error::malformed(file, format!("{uri}: {message}")))
    }

    /// Adds triangles of the next instance to a layer, except those without any area. `what` names them, for messages.
    pub fn place(
        &mut self,
        layer: Layer,
        part: &Part,
        world_from_part: DMat4,
        file: &Path,
        what: &dyn Fn() -> String,
    ) -> Result<()> {
        interrupt::check()?;
        let layer = layer as usize;
        let read = self.read[layer] + part.triangles.len();
        let vertices = self.layers[layer].cells.len() + part.vertices.len();
        let limit = self.options.max_triangles;
        if read > limit || vertices > 3 * limit || vertices > u32::MAX as usize {
            let message = format!("{}: the scene has more than {limit} triangles", what());
            return Err(Error::malformed(file, message));
        }
        let moved = |v: &DVec3| world_from_part.transform_point3(*v);
        let placed: Vec<DVec3> = part.vertices.iter().map(moved).collect();
        // Vertices that no triangle uses do not matter. The comparison is false for NaN.
        let near = |i: &u32| placed[*i as usize].abs().max_element() <= MAX_COORDINATE;
        if !part.triangles.iter().flatten().all(near) {
            let message = format!(
                "{}: farther than {MAX_COORDINATE} m from the origin, dropped",
                what()
            );
            return self.loss(Error::malformed(file, message));
        }
        self.read[layer] = read;
        let soup = &mut self.layers[layer];
        let base = soup.cells.len() as u32;
        soup.cells.extend(placed.iter().map(|v| clean::cell(*v)));
        soup.mesh
            .vertices
            .extend(placed.iter().map(|v| v.as_vec3()));
        let shifted = part.triangles.iter().map(|t| t.map(|i| i + base));
        soup.mesh.triangles.extend(shifted);
        let number = self.instances as u32 + 1;
        soup.objects.extend(part.triangles.iter().map(|_| number));
        Ok(())
    }

    /// Adds an infinite horizontal plane; of several in a layer the highest counts.
    pub fn place_plane(&mut self, layer: Layer, height: f64) {
        let height = height as f32;
        let plane = &mut self.planes[layer as usize];
        *plane = Some(plane.map_or(height, |z: f32| z.max(height)));
    }

    pub fn finish(self, path: &Path) -> Result<Scene> {
        let mut read = self.read;
        let [(mut visual, mut objects), (mut collision, _)] = self.layers.map(Soup::clean);
        if self.lone {
            objects = clean::connected_parts(&visual);
        }
        let visual_bounds = visual.bounds();
        let collision_bounds = collision.bounds();
        let ground_plane = self.planes[Layer::Collision as usize].or(self.planes[0]);
        let extent = [
            visual_bounds,
            collision_bounds,
            visual_bounds.union(&collision_bounds),
        ];
        if extent[2].is_empty() && ground_plane.is_none() {
            return Err(Error::malformed(
                path,
                match self.warnings.keys().next() {
                    Some(warning) => format!("holds no triangles; {warning}"),
                    None => "holds no triangles".to_owned(),
                },
            ));
        }
        if let Some(z) = ground_plane {
            let all = if extent[2].is_empty() {
                Aabb::new(Vec3::ZERO, Vec3::ZERO)
            } else {
                extent[2]
            };
            // The plane is seen wherever it is hit; it is hit only if a collision shape says so.
            for (i, mesh) in [&mut visual, &mut collision].into_iter().enumerate() {
                if i == 1 && self.planes[1].is_none() {
                    continue;
                }
                let around = if extent[i].is_empty() { all } else { extent[i] };
                read[i] += 2;
                mesh.append(&square(around.grown(PLANE_MARGIN), z));
            }
        }
        objects.resize(visual.triangles.len(), 0);
        let mut report = LoadReport {
            visual_triangles_read: read[0],
            collision_triangles_read: read[1],
            instances: self.instances,
            warnings: Vec::new(),
            missing: self.missing.into_iter().collect(),
            visual_bounds,
            collision_bounds,
            load_milliseconds: 0.0,
            cache: String::new(),
        };
        report.warnings = self
            .warnings
            .into_iter()
            .map(|(text, count)| match count {
                1 => text,
                _ => format!("{text} ({count} times)"),
            })
            .collect();
        if self.more > 0 {
            report
                .warnings
                .push(format!("... and {} more warnings", self.more));
        }
        let extent = if extent[0].is_empty() {
            extent[2]
        } else {
            extent[0]
        };
        let extent = match ground_plane {
            Some(z) if extent.is_empty() => {
                square(Aabb::new(Vec3::splat(-5.0), Vec3::splat(5.0)), z).bounds()
            }
            _ => extent,
        };
        let floor = clean::floor(&visual, extent, ground_plane);
        let mut bounds = extent;
        bounds.min.z = floor - BELOW_FLOOR;
        bounds.max.z = extent.max.z.min(floor + ABOVE_FLOOR).max(floor);
        Ok(Scene {
            name: path
                .file_stem()
                .map(|s| s.to_string_lossy().into_owned())
                .unwrap_or_default(),
            visual,
            objects,
            collision,
            ground_plane,
            floor,
            bounds,
            starts: Vec::new(),
            actors: self.actors,
            report,
        })
    }
}

fn square(around: Aabb, z: f32) -> Mesh {
    let (low, high) = (around.min, around.max);
    let corners = [
        (low.x, low.y),
        (high.x, low.y),
        (high.x, high.y),
        (low.x, high.y),
    ];
    Mesh {
        vertices: corners.map(|(x, y)| Vec3::new(x, y, z)).to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

/// A finite transform, or an error that names where it comes from.
pub(super) fn finite(transform: DMat4, file: &Path, what: &dyn Fn() -> String) -> Result<DMat4> {
    let far = transform.transform_point3(DVec3::ZERO);
    if transform.is_finite() && far.is_finite() {
        Ok(transform)
    } else {
        Err(Error::malformed(
            file,
            format!("{}: the pose is not finite", what()),
        ))
    }
}
