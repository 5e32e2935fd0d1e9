//! PLY through ply-rs-bw, one element at a time: polygons of any size, and the triangle strips of older scans.
use std::io::BufRead;
use std::path::Path;

use glam::DVec3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyType,
    ScalarType,
};

use super::part::Part;
use super::LoadOptions;
use crate::error::{Error, Result};

/// Names of the list of corners.
const CORNERS: [&str; 2] = ["vertex_indices", "vertex_index"];
const MAX_HEADER_LINES: usize = 1000;

pub(super) fn read(path: &Path, bytes: &[u8], options: &LoadOptions) -> Result<Part> {
    parse(bytes, options).map_err(|message| Error::malformed(path, message))
}

fn parse(bytes: &[u8], options: &LoadOptions) -> std::result::Result<Part, String> {
    let lines = bytes.split(|b| *b == b'\n').take(MAX_HEADER_LINES);
    let ends = |line: &[u8]| line.trim_ascii() == b"end_header";
    if !lines.clone().any(ends) {
        return Err(format!("no end_header in {MAX_HEADER_LINES} lines"));
    }
    let mut reader = Reader::new(bytes);
    let header = Parser::<Other>::new()
        .read_header(&mut reader)
        .map_err(|e| e.to_string())?;
    let mut rest = reader.into_inner();
    check_length(&header, rest.len())?;

    let mut part = Part::default();
    let mut faces = false;
    for (name, element) in &header.elements {
        match name.as_str() {
            "vertex" => {
                let scalar = |axis| {
                    let property = element.properties.get(axis);
                    matches!(property, Some(p) if matches!(p.data_type, PropertyType::Scalar(_)))
                };
                if !["x", "y", "z"].into_iter().all(scalar) {
                    return Err("element vertex has no x, y and z".to_owned());
                }
                if element.count > 3 * options.max_triangles {
                    return Err(format!("{} vertices are too many", element.count));
                }
                each(&mut rest, &header, element, |vertex: Vertex| {
                    part.push_vertex(vertex.0)
                })?;
            }
            "face" | "tristrips" => {
                faces = true;
                let list = CORNERS.iter().find_map(|c| element.properties.get(*c));
                let list = list.map(|property| &property.data_type);
                if !matches!(list, Some(PropertyType::List(..))) {
                    return Err(format!("element {name} has no list vertex_indices"));
                }
                let strips = name == "tristrips";
                each(&mut rest, &header, element, |face: Face| {
                    face.push(&mut part, strips, options.max_triangles)
                })?;
            }
            _ => each(&mut rest, &header, element, |_: Other| Ok(()))?,
        }
    }
    if faces {
        Ok(part)
    } else {
        Err("has no faces (a point cloud is no scene)".to_owned())
    }
}

/// The header's counts are promises; refuse those that the file is too short to keep.
fn check_length(header: &Header, available: usize) -> std::result::Result<(), String> {
    let mut least = 0usize;
    for element in header.elements.values() {
        let size: usize = match header.encoding {
            Encoding::Ascii => 2 * element.properties.len(),
            _ => element
                .properties
                .values()
                .map(|p| bytes_of(&p.data_type))
                .sum(),
        };
        // An element without properties would be read for ever from nothing.
        least = least.saturating_add(element.count.saturating_mul(size.max(1)));
    }
    // The last line of an ASCII file may lack its line break.
    if least > available.saturating_add(1) {
        return Err(format!(
            "the header promises at least {least} bytes, {available} follow"
        ));
    }
    Ok(())
}

/// Of a list at least its length is there.
fn bytes_of(kind: &PropertyType) -> usize {
    let (PropertyType::Scalar(scalar) | PropertyType::List(scalar, _)) = kind;
    match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}

/// Reads all elements of one kind; only one is held at a time.
fn each<E: PropertyAccess>(
    rest: &mut &[u8],
    header: &Header,
    element: &ElementDef,
    mut take: impl FnMut(E) -> std::result::Result<(), String>,
) -> std::result::Result<(), String> {
    let parser = Parser::<E>::new();
    let mut line = String::new();
    for i in 0..element.count {
        let read = match header.encoding {
            Encoding::Ascii => {
                line.clear();
                rest.read_line(&mut line)
                    .map_err(|e| format!("{} {i}: {e}", element.name))?;
                parser.read_ascii_element(&line, element)
            }
            Encoding::BinaryLittleEndian => parser.read_little_endian_element(rest, element),
            Encoding::BinaryBigEndian => parser.read_big_endian_element(rest, element),
        };
        read.map_err(|e| e.to_string())
            .and_then(&mut take)
            .map_err(|message| format!("{} {i}: {message}", element.name))?;
    }
    Ok(())
}

/// An element of no interest.
struct Other;

impl PropertyAccess for Other {
    fn new() -> Self {
        Self
    }
}

struct Vertex(DVec3);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self(DVec3::NAN)
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let target = match name {
            "x" => &mut self.0.x,
            "y" => &mut self.0.y,
            "z" => &mut self.0.z,
            _ => return PropertyAccessResult::Ignored,
        };
        *target = match property {
            Property::Double(value) => value,
            other => other.to_f32_lossy().map_or(f64::NAN, f64::from),
        };
        PropertyAccessResult::Set
    }
}

/// Corners; in a strip a negative number starts a new one.
struct Face(Vec<i64>);

impl PropertyAccess for Face {
    fn new() -> Self {
        Self(Vec::new())
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if !CORNERS.contains(&name) {
            return PropertyAccessResult::Ignored;
        }
        self.0 = match property {
            Property::ListChar(list) => list.into_iter().map(i64::from).collect(),
            Property::ListUChar(list) => list.into_iter().map(i64::from).collect(),
            Property::ListShort(list) => list.into_iter().map(i64::from).collect(),
            Property::ListUShort(list) => list.into_iter().map(i64::from).collect(),
            Property::ListInt(list) => list.into_iter().map(i64::from).collect(),
            Property::ListUInt(list) => list.into_iter().map(i64::from).collect(),
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

impl Face {
    fn push(
        &self,
        part: &mut Part,
        strips: bool,
        max_triangles: usize,
    ) -> std::result::Result<(), String> {
        let corner = |index: &i64| u32::try_from(*index).map_err(|_| format!("index {index}"));
        if !strips {
            let corners: Vec<u32> = self
                .0
                .iter()
                .map(corner)
                .collect::<std::result::Result<_, _>>()?;
            return part.push_polygon(&corners, max_triangles);
        }
        for strip in self.0.split(|index| *index < 0) {
            for (i, triangle) in strip.windows(3).enumerate() {
                let [a, b, c] = [
                    corner(&triangle[0])?,
                    corner(&triangle[1])?,
                    corner(&triangle[2])?,
                ];
                let turned = if i % 2 == 0 { [a, b, c] } else { [b, a, c] };
                part.push_polygon(&turned, max_triangles)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(crate) const ASCII: &str = "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 4\nproperty float x\n\
        property double y\nproperty float z\nproperty uchar red\nelement face 2\nproperty list uchar int vertex_indices\n\
        element edge 1\nproperty int v\nend_header\n0 0 0 9\n1 0 0 9\n1 1 0 9\n0 1 -2.5e-1 9\n4 0 1 2 3\n3 0 1 2\n7\n";

    fn read_bytes(bytes: &[u8]) -> Result<Part> {
        read(Path::new("a.ply"), bytes, &LoadOptions::default())
    }

    pub(crate) fn binary_quad(big: bool) -> Vec<u8> {
        let order = if big { "big" } else { "little" };
        let mut bytes = format!(
            "ply\nformat binary_{order}_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
             property float z\nelement face 1\nproperty uchar flags\nproperty list uchar uint vertex_index\nend_header\n"
        )
        .into_bytes();
        for v in [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 2.0] {
            bytes.extend(if big {
                v.to_be_bytes()
            } else {
                v.to_le_bytes()
            });
        }
        bytes.extend([77, 4]);
        for i in 0..4u32 {
            bytes.extend(if big {
                i.to_be_bytes()
            } else {
                i.to_le_bytes()
            });
        }
        bytes
    }

    #[test]
    fn ascii_and_binary_are_read() {
        let part = read_bytes(ASCII.as_bytes()).unwrap();
        assert_eq!(part.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
        assert_eq!(part.vertices[3], DVec3::new(0.0, 1.0, -0.25));
        for big in [false, true] {
            let part = read_bytes(&binary_quad(big)).unwrap();
            assert_eq!(part.triangles, [[0, 1, 2], [0, 2, 3]]);
            assert_eq!(part.vertices[3], DVec3::new(0.0, 1.0, 2.0));
        }
    }

    #[test]
    fn strips_are_read() {
        let text = ASCII
            .replace("element face 2", "element tristrips 1")
            .replace("4 0 1 2 3\n3 0 1 2\n", "8 0 1 2 3 -1 0 1 3\n");
        let part = read_bytes(text.as_bytes()).unwrap();
        assert_eq!(part.triangles, [[0, 1, 2], [2, 1, 3], [0, 1, 3]]);
    }

    #[test]
    fn broken_files_are_refused() {
        let of = |from: &str, to: &str| ASCII.replace(from, to);
        for (text, word) in [
            (of("vertex 4", "vertex 99999999999"), "promises"),
            (of("face 2", "face 200"), "promises"),
            (of("4 0 1 2 3", "4 0 1 2 4"), "face 0: index 4"),
            (of("4 0 1 2 3", "4 0 1 2 -1"), "face 0: index -1"),
            (of("4 0 1 2 3", "9 0 1 2 3"), "face 0"),
            (of("uchar int vertex", "uchar float vertex"), "face 0"),
            (of("property float x", "property float w"), "x, y and z"),
            (of("end_header", "end"), "end_header"),
            (of("element face", "element facets"), "no faces"),
            (
                "ply\nformat ascii 1.0\nelement a 18446744073709551615\nend_header\n".into(),
                "promises",
            ),
        ] {
            let message = read_bytes(text.as_bytes()).unwrap_err().to_string();
            assert!(message.contains(word), "{message}");
        }
        let mut nan = binary_quad(false);
        let at = nan.len() - 18 - 4;
        nan[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        let message = read_bytes(&nan).unwrap_err().to_string();
        assert!(message.contains("vertex 3"), "{message}");
    }
}
