//! glTF and GLB: the triangles of the default scene. The crate only parses the JSON; it trusts the rest of a file
//! (panics on bad strides, gigabyte allocations, paths outside the asset), so every length is checked here.
use std::collections::HashMap;
use std::path::Path;
use std::rc::Rc;

use glam::{DMat4, DQuat, DVec3};
use gltf::json;
use json::accessor::{ComponentType, Type};
use json::mesh::{Mode, Primitive, Semantic};
use json::validation::Checked;

use super::gltf_buffers::Buffers;
use super::part::Part;
use super::{LoadOptions, MAX_DEPTH, MAX_NODES};
use crate::error::{Error, Result};

/// Limits on the JSON, whose parsed form is a hundred times as large.
const MAX_OBJECTS: usize = 2_000_000;
const MAX_COMMAS: usize = 16_000_000;
/// Elements of an accessor that is all zeros but for sparse entries, and so costs nothing in the file.
const MAX_SPARSE: usize = 1_000_000;
/// Required extensions that do not touch positions, by prefix.
const HARMLESS: [&str; 8] = [
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_",
    "KHR_xmp",
    "KHR_mesh_quantization",
    "EXT_texture_",
    "EXT_lights_",
    "MSFT_texture_",
];

type Reading<T> = std::result::Result<T, String>;

/// Reads the default scene in the file's own frame (y up after the format's rule).
pub(super) fn read(
    path: &Path,
    bytes: &[u8],
    options: &LoadOptions,
    notes: &mut Vec<String>,
) -> Result<Part> {
    let fail = |message: String| Error::malformed(path, message);
    let (text, chunk) = if bytes.starts_with(b"glTF") {
        split_glb(bytes).map_err(fail)?
    } else {
        (bytes, None)
    };
    let count = |what: u8| text.iter().filter(|b| **b == what).count();
    if count(b'{') > MAX_OBJECTS || count(b',') > MAX_COMMAS {
        return Err(fail(format!("JSON of more than {MAX_OBJECTS} objects")));
    }
    let root = json::Root::from_slice(text).map_err(|e| fail(format!("not valid glTF: {e}")))?;
    if !root.asset.version.starts_with("2.") {
        return Err(fail(format!(
            "glTF version '{}', not 2",
            root.asset.version
        )));
    }
    for extension in &root.extensions_required {
        if !HARMLESS.iter().any(|prefix| extension.starts_with(prefix)) {
            return Err(fail(format!(
                "requires extension {extension}, which is not supported"
            )));
        }
    }
    for extension in ["EXT_mesh_gpu_instancing", "KHR_node_visibility"] {
        if root.extensions_used.iter().any(|used| used == extension) {
            notes.push(format!(
                "{}: extension {extension} is ignored",
                path.display()
            ));
        }
    }
    let mut reader = Reader {
        buffers: Buffers::new(path, &root, chunk),
        root: &root,
        max_triangles: options.max_triangles,
        positions: HashMap::new(),
        meshes: HashMap::new(),
        part: Part::default(),
        visits: 0,
        skipped: 0,
    };
    for node in reader.top_nodes().map_err(fail)? {
        reader.node(node, DMat4::IDENTITY, 0).map_err(fail)?;
    }
    if reader.skipped > 0 {
        let skipped = reader.skipped;
        notes.push(format!(
            "{}: {skipped} primitives of points or lines were skipped",
            path.display()
        ));
    }
    Ok(reader.part)
}

/// The JSON and binary chunks of a GLB.
fn split_glb(bytes: &[u8]) -> Reading<(&[u8], Option<&[u8]>)> {
    let word = |at: usize| {
        let word = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes([word[0], word[1], word[2], word[3]]) as usize)
    };
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err("a GLB header has 12 bytes".to_owned());
    };
    if version != 2 {
        return Err(format!("GLB version {version}, not 2"));
    }
    if !(12..=bytes.len()).contains(&length) {
        return Err(format!(
            "the GLB header declares {length} bytes, the file has {}",
            bytes.len()
        ));
    }
    let mut chunks = Vec::new();
    let mut at = 12;
    while at < length && chunks.len() < 2 {
        let (Some(size), Some(kind)) = (word(at), bytes.get(at + 4..at + 8)) else {
            return Err(format!("a GLB chunk is cut off at byte {at}"));
        };
        let end = at + 8 + size;
        if end > length {
            return Err(format!(
                "a GLB chunk at byte {at} of {size} bytes reaches beyond the end"
            ));
        }
        chunks.push((kind, &bytes[at + 8..end]));
        // Chunks are aligned; writers that forget so are read, too, since sizes are what counts.
        at = end;
    }
    match chunks[..] {
        [(b"JSON", text)] => Ok((text, None)),
        [(b"JSON", text), (kind, data)] => Ok((text, (kind == b"BIN\0").then_some(data))),
        _ => Err("the first GLB chunk is not JSON".to_owned()),
    }
}

struct Reader<'a> {
    root: &'a json::Root,
    buffers: Buffers<'a>,
    max_triangles: usize,
    positions: HashMap<usize, Rc<Vec<DVec3>>>,
    meshes: HashMap<usize, Rc<Part>>,
    part: Part,
    visits: usize,
    skipped: usize,
}

impl<'a> Reader<'a> {
    /// The roots of the default scene; without any scene all nodes that are no children.
    fn top_nodes(&self) -> Reading<Vec<usize>> {
        let chosen = self.root.scene.map_or(0, |scene| scene.value());
        match self.root.scenes.get(chosen) {
            Some(scene) => Ok(scene.nodes.iter().map(|node| node.value()).collect()),
            None if self.root.scene.is_some() => Err(format!("no scene {chosen}")),
            None => {
                let mut top = vec![true; self.root.nodes.len()];
                for child in self
                    .root
                    .nodes
                    .iter()
                    .flat_map(|n| n.children.iter().flatten())
                {
                    if let Some(top) = top.get_mut(child.value()) {
                        *top = false;
                    }
                }
                Ok((0..top.len()).filter(|i| top[*i]).collect())
            }
        }
    }

    fn node(&mut self, index: usize, parent: DMat4, depth: usize) -> Reading<()> {
        self.visits += 1;
        if depth > MAX_DEPTH || self.visits > MAX_NODES {
            return Err(format!(
                "node {index}: more than {MAX_DEPTH} levels or {MAX_NODES} nodes"
            ));
        }
        let root = self.root;
        let node = root
            .nodes
            .get(index)
            .ok_or_else(|| format!("no node {index}"))?;
        let vector = |v: [f32; 3]| DVec3::from(v.map(f64::from));
        let local = match node.matrix {
            Some(matrix) => DMat4::from_cols_array(&matrix.map(f64::from)),
            None => {
                let rotation = node.rotation.map_or([0.0, 0.0, 0.0, 1.0], |r| r.0);
                let rotation = DQuat::from_array(rotation.map(f64::from));
                if rotation.length_squared() < 1e-12 {
                    return Err(format!("node {index}: a rotation of length 0"));
                }
                DMat4::from_scale_rotation_translation(
                    node.scale.map_or(DVec3::ONE, vector),
                    rotation.normalize(),
                    node.translation.map_or(DVec3::ZERO, vector),
                )
            }
        };
        let world = parent * local;
        if !world.is_finite() {
            return Err(format!("node {index}: the transform is not finite"));
        }
        if let Some(mesh) = node.mesh {
            let mesh = self.mesh(mesh.value())?;
            self.part
                .append(&mesh, world, self.max_triangles)
                .map_err(|message| format!("node {index}: {message}"))?;
        }
        for child in node.children.iter().flatten() {
            self.node(child.value(), world, depth + 1)?;
        }
        Ok(())
    }

    fn mesh(&mut self, index: usize) -> Reading<Rc<Part>> {
        if let Some(mesh) = self.meshes.get(&index) {
            return Ok(mesh.clone());
        }
        let root = self.root;
        let mesh = root
            .meshes
            .get(index)
            .ok_or_else(|| format!("no mesh {index}"))?;
        let mut part = Part::default();
        for (i, primitive) in mesh.primitives.iter().enumerate() {
            let name = mesh.name.as_deref().unwrap_or("");
            self.primitive(primitive, &mut part)
                .map_err(|message| format!("mesh {index} '{name}', primitive {i}: {message}"))?;
        }
        let part = Rc::new(part);
        self.meshes.insert(index, part.clone());
        Ok(part)
    }

    fn primitive(&mut self, primitive: &Primitive, part: &mut Part) -> Reading<()> {
        let mode = match primitive.mode {
            Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => {
                mode
            }
            Checked::Valid(_) => {
                self.skipped += 1;
                return Ok(());
            }
            Checked::Invalid => return Err("an unknown mode".to_owned()),
        };
        let Some(accessor) = primitive
            .attributes
            .get(&Checked::Valid(Semantic::Positions))
        else {
            // Permitted, and nothing to see.
            return Ok(());
        };
        let positions = self.positions(accessor.value())?;
        let indices = match primitive.indices {
            Some(accessor) => self.indices(accessor.value())?,
            None => (0..positions.len() as u32).collect(),
        };
        let outside = |index: u32| {
            let count = positions.len();
            format!("index {index}, but there are {count} vertices")
        };
        let mut corners = Vec::with_capacity(indices.len());
        if positions.len() <= indices.len() {
            let base = part.vertices.len() as u32;
            for position in positions.iter() {
                part.push_vertex(*position)?;
            }
            for index in indices {
                if index as usize >= positions.len() {
                    return Err(outside(index));
                }
                corners.push(base + index);
            }
        } else {
            // Many primitives may share one large accessor: take only what this one uses.
            let mut taken = HashMap::with_capacity(indices.len());
            for index in indices {
                let corner = match taken.get(&index) {
                    Some(corner) => *corner,
                    None => {
                        let position = positions
                            .get(index as usize)
                            .ok_or_else(|| outside(index))?;
                        let corner = part.vertices.len() as u32;
                        part.push_vertex(*position)?;
                        taken.insert(index, corner);
                        corner
                    }
                };
                corners.push(corner);
            }
        }
        if part.vertices.len() > 3 * self.max_triangles {
            return Err(format!("more than {} triangles", self.max_triangles));
        }
        let limit = self.max_triangles;
        match mode {
            Mode::TriangleFan => part.push_polygon(&corners, limit),
            Mode::TriangleStrip => corners.windows(3).enumerate().try_for_each(|(i, t)| {
                let turned = if i % 2 == 0 {
                    [t[0], t[1], t[2]]
                } else {
                    [t[1], t[0], t[2]]
                };
                part.push_polygon(&turned, limit)
            }),
            _ if corners.len() % 3 != 0 => {
                Err(format!("{} indices are no triangles", corners.len()))
            }
            _ => corners
                .chunks_exact(3)
                .try_for_each(|t| part.push_polygon(t, limit)),
        }
    }

    fn positions(&mut self, index: usize) -> Reading<Rc<Vec<DVec3>>> {
        if let Some(positions) = self.positions.get(&index) {
            return Ok(positions.clone());
        }
        let (accessor, component) = self.accessor(index, Type::Vec3)?;
        let name = format!("position accessor {index}");
        let normalized = accessor.normalized;
        // Integers are permitted by KHR_mesh_quantization.
        let read = move |bytes: &[u8]| -> f64 {
            let (value, largest) = match component {
                ComponentType::I8 => (f64::from(bytes[0] as i8), 127.0),
                ComponentType::U8 => (f64::from(bytes[0]), 255.0),
                ComponentType::I16 => {
                    (f64::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32767.0)
                }
                ComponentType::U16 => {
                    (f64::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65535.0)
                }
                _ => {
                    let value = f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
                    (f64::from(value), 1.0)
                }
            };
            if normalized {
                (value / largest).max(-1.0)
            } else {
                value
            }
        };
        let width = match component {
            ComponentType::U32 => return Err(format!("{name}: positions of 32-bit integers")),
            other => other.size(),
        };
        let vector = |bytes: &[u8]| {
            DVec3::new(
                read(bytes),
                read(&bytes[width..]),
                read(&bytes[2 * width..]),
            )
        };
        let count = accessor.count.0 as usize;
        let mut values: Vec<DVec3> = match accessor.buffer_view {
            Some(view) => {
                let offset = accessor.byte_offset.map_or(0, |o| o.0);
                let slice = self.buffers.slice(view.value(), offset, 3 * width, count);
                slice
                    .map_err(|m| format!("{name}: {m}"))?
                    .iter()
                    .map(vector)
                    .collect()
            }
            None if accessor.sparse.is_none() => {
                return Err(format!("{name}: no bufferView (is the mesh compressed?)"));
            }
            None if count > MAX_SPARSE => {
                return Err(format!("{name}: {count} elements, but nothing in the file"));
            }
            None => vec![DVec3::ZERO; count],
        };
        if let Some(sparse) = &accessor.sparse {
            let stored = usize::try_from(sparse.count.0).unwrap_or(usize::MAX);
            if stored > count {
                return Err(format!("{name}: {stored} sparse values of {count}"));
            }
            let size = match sparse.indices.component_type {
                Checked::Valid(json::accessor::IndexComponentType(kind)) => kind.size(),
                Checked::Invalid => return Err(format!("{name}: sparse indices of unknown type")),
            };
            let view = sparse.indices.buffer_view.value();
            let targets = self
                .buffers
                .slice(view, sparse.indices.byte_offset.0, size, stored)
                .map_err(|m| format!("{name}, sparse indices: {m}"))?;
            let targets: Vec<u32> = targets.iter().map(unsigned).collect();
            let view = sparse.values.buffer_view.value();
            let stored = self
                .buffers
                .slice(view, sparse.values.byte_offset.0, 3 * width, stored)
                .map_err(|m| format!("{name}, sparse values: {m}"))?;
            for (target, bytes) in targets.into_iter().zip(stored.iter()) {
                let value = values.get_mut(target as usize);
                *value.ok_or_else(|| format!("{name}: sparse index {target} of {count}"))? =
                    vector(bytes);
            }
        }
        let values = Rc::new(values);
        self.positions.insert(index, values.clone());
        Ok(values)
    }

    fn indices(&mut self, index: usize) -> Reading<Vec<u32>> {
        let name = format!("index accessor {index}");
        let (accessor, component) = self.accessor(index, Type::Scalar)?;
        let width = match component {
            ComponentType::U8 => 1,
            ComponentType::U16 => 2,
            ComponentType::U32 => 4,
            other => return Err(format!("{name}: indices of type {other:?}")),
        };
        let (Some(view), None) = (accessor.buffer_view, &accessor.sparse) else {
            return Err(format!("{name}: sparse, or without a bufferView"));
        };
        let offset = accessor.byte_offset.map_or(0, |o| o.0);
        let slice = self
            .buffers
            .slice(view.value(), offset, width, accessor.count.0 as usize);
        Ok(slice
            .map_err(|m| format!("{name}: {m}"))?
            .iter()
            .map(unsigned)
            .collect())
    }

    /// An accessor of the expected type and a sane count.
    fn accessor(
        &self,
        index: usize,
        expected: Type,
    ) -> Reading<(&'a json::Accessor, ComponentType)> {
        let accessor = self
            .root
            .accessors
            .get(index)
            .ok_or_else(|| format!("no accessor {index}"))?;
        if accessor.type_ != Checked::Valid(expected) {
            return Err(format!("accessor {index}: not of type {expected:?}"));
        }
        if accessor.count.0 > 3 * self.max_triangles as u64 {
            return Err(format!("accessor {index}: {} elements", accessor.count.0));
        }
        match accessor.component_type {
            Checked::Valid(json::accessor::GenericComponentType(kind)) => Ok((accessor, kind)),
            Checked::Invalid => Err(format!("accessor {index}: unknown component type")),
        }
    }
}

/// A little-endian number of one, two or four bytes.
fn unsigned(bytes: &[u8]) -> u32 {
    bytes
        .iter()
        .rev()
        .fold(0, |value, byte| value << 8 | u32::from(*byte))
}
