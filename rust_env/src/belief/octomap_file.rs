//! OctoMap's files: `.bt` (free or occupied, two bits a child) and `.ot` (log-odds), the `.bt` of before OctoMap 1.4
//! included. Of coloured and stamped trees the geometry and the log-odds are read. Read with every length checked,
//! without recursion, and with a cap on what a file may expand to.
use super::octree::{Octree, SensorModel, State, KEY_LIMIT};
use crate::error::{Error, Result};
use crate::geometry::IVec3;
use std::path::Path;

/// Levels below the root; a leaf at this depth is one voxel.
const DEPTH: u32 = 16;
/// Most voxels that a file's leaves may expand to (4.3 bytes each in the map).
const MAX_VOXELS: u64 = 1 << 28;
/// A short file may expand to this many voxels at once, and to so many more for each of its bytes: a hundred bytes
/// must not become a gigabyte.
const VOXELS: u64 = 1 << 24;
const VOXELS_PER_BYTE: u64 = 1 << 15;

/// A cube of `1 << (DEPTH - depth)` voxels a side with one value.
struct Leaf {
    corner: IVec3,
    depth: u32,
    log_odds: f32,
}

fn child_corner(corner: IVec3, depth: u32, child: i32) -> IVec3 {
    let side = 1 << (DEPTH - depth - 1);
    corner + IVec3::new(child & 1, child >> 1 & 1, child >> 2) * side
}

struct Header {
    binary: bool,
    kind: String,
    size: u64,
    resolution: f64,
    /// Where the data begins.
    data: usize,
}

/// The first word of files from before OctoMap 1.4: the type of the tree, in a header of 16 bytes (i32, f64, u32).
const LEGACY: [u8; 4] = 3i32.to_le_bytes();

fn header(path: &Path, bytes: &[u8]) -> Result<Header> {
    let broken = |what: String| Error::malformed(path, what);
    if let Some((&LEGACY, rest)) = bytes.split_first_chunk() {
        let Some((resolution, rest)) = rest.split_first_chunk() else {
            return Err(broken("the header ends too early".into()));
        };
        let Some((size, _)) = rest.split_first_chunk() else {
            return Err(broken("the header ends too early".into()));
        };
        return Ok(Header {
            binary: true,
            kind: "OcTree".to_owned(),
            size: u32::from_le_bytes(*size).into(),
            resolution: f64::from_le_bytes(*resolution),
            data: 16,
        });
    }
    let mut at = 0;
    let mut line = || -> Result<String> {
        let rest = &bytes[at..];
        // No header line of OctoMap's is near this long.
        let end = rest.iter().take(4096).position(|b| *b == b'\n');
        let end = end.ok_or_else(|| broken("the header ends too early".into()))?;
        at += end + 1;
        Ok(String::from_utf8_lossy(&rest[..end]).trim().to_owned())
    };
    let first = line()?;
    let binary = match first.as_str() {
        "# Octomap OcTree binary file" => true,
        "# Octomap OcTree file" => false,
        _ => {
            return Err(broken(
                "not an OctoMap file (its first line says neither .bt nor .ot)".into(),
            ))
        }
    };
    let (mut kind, mut size, mut resolution) = (String::from("OcTree"), None, None);
    loop {
        let text = line()?;
        let mut words = text.split_whitespace();
        let (name, value) = (words.next().unwrap_or("#"), words.next().unwrap_or(""));
        match name {
            "data" => break,
            "id" => value.clone_into(&mut kind),
            "size" => {
                size = Some(
                    value
                        .parse()
                        .map_err(|_| broken(format!("size {value:?} is no number")))?,
                )
            }
            "res" => {
                resolution = Some(
                    value
                        .parse::<f64>()
                        .map_err(|_| broken(format!("res {value:?} is no number")))?,
                )
            }
            _ => {}
        }
    }
    let resolution = resolution.filter(|r| r.is_finite() && *r > 0.0);
    let resolution = resolution.ok_or_else(|| broken("res is missing or not above 0".into()))?;
    let size = size.ok_or_else(|| broken("size is missing".into()))?;
    Ok(Header {
        binary,
        kind,
        size,
        resolution,
        data: at,
    })
}

/// The map in a file's bytes; `path` is only named in errors. Hits and misses that follow use `sensor`. In a `.bt` map free
/// and occupied become the clamping values.
pub fn parse(path: &Path, bytes: &[u8], sensor: SensorModel) -> Result<Octree> {
    let header = header(path, bytes)?;
    // A stamped tree's times are not in the file; a colour is three bytes after the log-odds. A `.bt` file has neither.
    let payload = match header.kind.as_str() {
        "OcTree" | "OcTreeStamped" => 4,
        "ColorOcTree" => 7,
        other => {
            return Err(Error::malformed(
                path,
                format!("tree id {other:?} is not supported (OcTree, ColorOcTree, OcTreeStamped)"),
            ))
        }
    };
    let data = &bytes[header.data..];
    let (leaves, nodes) = if header.size == 0 {
        (Vec::new(), 0)
    } else if header.binary {
        binary_leaves(path, data, sensor)?
    } else {
        valued_leaves(path, data, payload)?
    };
    if nodes != header.size {
        return Err(Error::malformed(
            path,
            format!(
                "the header says {} nodes, the data holds {nodes}",
                header.size
            ),
        ));
    }
    let volume = leaves
        .iter()
        .map(|l| 1u64 << (3 * (DEPTH - l.depth)))
        .fold(0u64, u64::saturating_add);
    let most = MAX_VOXELS.min(VOXELS + VOXELS_PER_BYTE * bytes.len() as u64);
    if volume > most {
        let length = bytes.len();
        return Err(Error::malformed(
            path,
            format!("its leaves hold {volume} voxels, more than {most} of {length} bytes"),
        ));
    }
    let mut octree = Octree::new(header.resolution, sensor)
        .map_err(|e| Error::malformed(path, e.to_string()))?;
    let (mut low, mut high) = (IVec3::MAX, IVec3::MIN);
    for leaf in &leaves {
        low = low.min(leaf.corner);
        high = high.max(leaf.corner + ((1 << (DEPTH - leaf.depth)) - 1));
    }
    if !leaves.is_empty() {
        octree
            .reserve(low >> 3, high >> 3)
            .map_err(|e| Error::malformed(path, e.to_string()))?;
    }
    for leaf in leaves {
        octree.set_cube(leaf.corner, 1 << (DEPTH - leaf.depth), leaf.log_odds);
    }
    Ok(octree)
}

fn take<'a>(path: &Path, data: &mut &'a [u8], n: usize) -> Result<&'a [u8]> {
    if data.len() < n {
        return Err(Error::malformed(path, "the data ends too early".to_owned()));
    }
    let (head, tail) = data.split_at(n);
    *data = tail;
    Ok(head)
}

const ROOT: IVec3 = IVec3::splat(-KEY_LIMIT);

/// `.bt`: two bits for each child of each inner node, depth first.
fn binary_leaves(path: &Path, mut data: &[u8], sensor: SensorModel) -> Result<(Vec<Leaf>, u64)> {
    let (mut leaves, mut nodes) = (Vec::new(), 1);
    let mut stack = vec![(ROOT, 0u32)];
    while let Some((corner, depth)) = stack.pop() {
        let word = take(path, &mut data, 2)?;
        let word = u16::from_le_bytes([word[0], word[1]]);
        // The first child is read first: it goes on the stack last.
        for child in (0..8).rev() {
            let at = child_corner(corner, depth, child);
            let log_odds = match word >> (2 * child) & 3 {
                0 => continue,
                1 => sensor.clamp_min,
                2 => sensor.clamp_max,
                _ if depth + 1 == DEPTH => {
                    return Err(Error::malformed(
                        path,
                        "an inner node at voxel depth".to_owned(),
                    ))
                }
                _ => {
                    nodes += 1;
                    stack.push((at, depth + 1));
                    continue;
                }
            };
            nodes += 1;
            leaves.push(Leaf {
                corner: at,
                depth: depth + 1,
                log_odds,
            });
        }
    }
    Ok((leaves, nodes))
}

/// `.ot`: for each node its value (and colour), then which children exist, depth first.
fn valued_leaves(path: &Path, mut data: &[u8], payload: usize) -> Result<(Vec<Leaf>, u64)> {
    let (mut leaves, mut nodes) = (Vec::new(), 0);
    let mut stack = vec![(ROOT, 0u32)];
    while let Some((corner, depth)) = stack.pop() {
        let node = take(path, &mut data, payload + 1)?;
        nodes += 1;
        let log_odds = f32::from_le_bytes([node[0], node[1], node[2], node[3]]);
        let children = node[payload];
        if !log_odds.is_finite() {
            return Err(Error::malformed(
                path,
                format!("node {nodes} has the log-odds {log_odds}"),
            ));
        }
        if children == 0 {
            leaves.push(Leaf {
                corner,
                depth,
                log_odds,
            });
        } else if depth == DEPTH {
            return Err(Error::malformed(
                path,
                "children below voxel depth".to_owned(),
            ));
        }
        for child in (0..8).rev().filter(|c| children >> c & 1 == 1) {
            stack.push((child_corner(corner, depth, child), depth + 1));
        }
    }
    Ok((leaves, nodes))
}

/// A node of the tree that is written.
enum Node {
    Leaf(f32),
    Inner(f32, [Option<Box<Node>>; 8]),
}

impl Node {
    /// OctoMap's inner value: the maximum of the children.
    fn value(&self) -> f32 {
        match self {
            Node::Leaf(v) | Node::Inner(v, _) => *v,
        }
    }

    fn count(&self) -> u64 {
        match self {
            Node::Leaf(_) => 1,
            Node::Inner(_, children) => {
                1 + children.iter().flatten().map(|c| c.count()).sum::<u64>()
            }
        }
    }
}

/// Interleaved bits, z highest: voxels in the order in which a depth-first walk meets them.
fn morton(key: IVec3) -> u64 {
    let k = (key + KEY_LIMIT).as_uvec3();
    (0..DEPTH).fold(0, |m, b| {
        m | u64::from(k.x >> b & 1) << (3 * b)
            | u64::from(k.y >> b & 1) << (3 * b + 1)
            | u64::from(k.z >> b & 1) << (3 * b + 2)
    })
}

/// The pruned tree over voxels sorted by Morton code; recursion is 16 deep at most.
fn tree(voxels: &[(u64, f32)], depth: u32) -> Option<Box<Node>> {
    let (_, value) = voxels.first()?;
    if depth == DEPTH {
        return Some(Box::new(Node::Leaf(*value)));
    }
    let shift = 3 * (DEPTH - depth - 1);
    let mut rest = voxels;
    let children: [Option<Box<Node>>; 8] = std::array::from_fn(|child| {
        let n = rest.partition_point(|(code, _)| (code >> shift & 7) as usize <= child);
        let (mine, others) = rest.split_at(n);
        rest = others;
        tree(mine, depth + 1)
    });
    let same = children
        .iter()
        .all(|c| matches!(c.as_deref(), Some(Node::Leaf(v)) if v == value));
    if same {
        return Some(Box::new(Node::Leaf(*value)));
    }
    let max = children
        .iter()
        .flatten()
        .map(|c| c.value())
        .fold(f32::NEG_INFINITY, f32::max);
    Some(Box::new(Node::Inner(max, children)))
}

/// The bytes of a `.bt` (`binary`: states only) or `.ot` file (log-odds).
pub fn serialise(octree: &Octree, binary: bool) -> Vec<u8> {
    let sensor = octree.sensor();
    let mut voxels = Vec::new();
    for state in [State::Free, State::Occupied] {
        for key in octree.keys(state) {
            let value = match (binary, state) {
                (true, State::Occupied) => sensor.clamp_max,
                (true, _) => sensor.clamp_min,
                (false, _) => octree.log_odds(key).unwrap_or(0.0),
            };
            voxels.push((morton(key), value));
        }
    }
    voxels.sort_unstable_by_key(|v| v.0);
    let root = tree(&voxels, 0);
    let size = root.as_ref().map_or(0, |r| r.count());
    let name = if binary {
        "# Octomap OcTree binary file"
    } else {
        "# Octomap OcTree file"
    };
    let mut out = format!(
        "{name}\n# (feel free to add / change comments, but leave the first line as it is!)\n#\nid OcTree\nsize {size}\nres {}\ndata\n",
        octree.resolution()
    )
    .into_bytes();
    if let Some(root) = root {
        if binary {
            write_binary(&root, &mut out)
        } else {
            write_valued(&root, &mut out)
        }
    }
    out
}

fn write_binary(node: &Node, out: &mut Vec<u8>) {
    let Node::Inner(_, children) = node else {
        return;
    };
    let word = children.iter().enumerate().fold(0u16, |word, (i, child)| {
        let bits = match child.as_deref() {
            None => 0,
            Some(Node::Leaf(v)) if *v < 0.0 => 1,
            Some(Node::Leaf(_)) => 2,
            Some(Node::Inner(..)) => 3,
        };
        word | bits << (2 * i)
    });
    out.extend(word.to_le_bytes());
    children.iter().flatten().for_each(|c| write_binary(c, out));
}

fn write_valued(node: &Node, out: &mut Vec<u8>) {
    out.extend(node.value().to_le_bytes());
    match node {
        Node::Leaf(_) => out.push(0),
        Node::Inner(_, children) => {
            out.push((0..8).fold(0, |m, i| m | u8::from(children[i].is_some()) << i));
            children.iter().flatten().for_each(|c| write_valued(c, out));
        }
    }
}

#[cfg(test)]
mod tests;
