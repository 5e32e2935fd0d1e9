//! STL, binary and ASCII; of several solids in a file all are read.
use std::path::Path;

use glam::DVec3;

use super::part::Part;
use super::LoadOptions;
use crate::error::{Error, Result};

const HEADER: usize = 84;
/// Normal, three corners, two bytes of attributes.
const FACET: usize = 50;

pub(super) fn read(path: &Path, bytes: &[u8], options: &LoadOptions) -> Result<Part> {
    let declared = bytes
        .get(80..HEADER)
        .map(|count| u32::from_le_bytes([count[0], count[1], count[2], count[3]]) as usize);
    // Binary files may start with "solid", too: the length decides.
    let fits = declared.is_some_and(|count| bytes.len() == HEADER + count * FACET);
    let result = if !fits && bytes.trim_ascii_start().starts_with(b"solid") {
        ascii(bytes, options)
    } else {
        binary(bytes, declared, options)
    };
    result.map_err(|message| Error::malformed(path, message))
}

fn binary(
    bytes: &[u8],
    declared: Option<usize>,
    options: &LoadOptions,
) -> std::result::Result<Part, String> {
    let count = declared.ok_or("neither ASCII nor long enough for a binary STL")?;
    let facets = bytes[HEADER..].chunks_exact(FACET);
    if facets.len() < count {
        let held = facets.len();
        return Err(format!("{count} facets are declared, {held} are there"));
    }
    if count > options.max_triangles {
        return Err(format!("more than {} triangles", options.max_triangles));
    }
    let mut part = Part::default();
    for (i, facet) in facets.take(count).enumerate() {
        let number = |at: usize| {
            f64::from(f32::from_le_bytes([
                facet[at],
                facet[at + 1],
                facet[at + 2],
                facet[at + 3],
            ]))
        };
        for at in [12, 24, 36] {
            part.push_vertex(DVec3::new(number(at), number(at + 4), number(at + 8)))
                .map_err(|message| format!("facet {i}: {message}"))?;
        }
        let base = 3 * i as u32;
        part.triangles.push([base, base + 1, base + 2]);
    }
    Ok(part)
}

fn ascii(bytes: &[u8], options: &LoadOptions) -> std::result::Result<Part, String> {
    let mut part = Part::default();
    let mut open = false;
    let mut corners: Vec<u32> = Vec::new();
    for (number, line) in bytes.split(|b| *b == b'\n').enumerate() {
        let fail = |message: String| format!("line {}: {message}", number + 1);
        let text = String::from_utf8_lossy(line);
        let mut words = text.split_ascii_whitespace();
        let Some(keyword) = words.next() else {
            continue;
        };
        match keyword.to_ascii_lowercase().as_str() {
            "solid" => open = true,
            "endsolid" => open = false,
            "facet" | "outer" | "endfacet" => {}
            "vertex" => {
                let mut coordinate = || {
                    let word = words.next().unwrap_or("");
                    word.parse::<f64>()
                        .map_err(|_| fail(format!("'{word}' is not a number")))
                };
                let vertex = DVec3::new(coordinate()?, coordinate()?, coordinate()?);
                corners.push(part.vertices.len() as u32);
                part.push_vertex(vertex).map_err(fail)?;
            }
            "endloop" => {
                if corners.len() != 3 {
                    return Err(fail(format!("a loop of {} vertices", corners.len())));
                }
                part.push_polygon(&corners, options.max_triangles)
                    .map_err(fail)?;
                corners.clear();
            }
            other => return Err(fail(format!("unknown keyword '{other}'"))),
        }
        if corners.len() > 3 {
            return Err(fail("a loop of more than 3 vertices".to_owned()));
        }
    }
    if open || !corners.is_empty() {
        return Err("cut off before 'endsolid'".to_owned());
    }
    Ok(part)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(crate) const ASCII: &str = "solid vertex of a name\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   \
        vertex 1 0 0\n   vertex 0 1e0 0\n  endloop\n endfacet\nendsolid\nsolid\nfacet normal 0 0 1\nouter loop\n\
        vertex 0 0 0\nvertex 1 0 0\nvertex 0 2 0\nendloop\nendfacet\nendsolid second\n";

    pub(crate) fn binary_file(facets: &[[f32; 9]]) -> Vec<u8> {
        let mut bytes = b"solid but binary".to_vec();
        bytes.resize(80, b' ');
        bytes.extend((facets.len() as u32).to_le_bytes());
        for facet in facets {
            bytes.extend([0; 12]);
            bytes.extend(facet.iter().flat_map(|v| v.to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    fn read_bytes(bytes: &[u8]) -> Result<Part> {
        read(Path::new("a.stl"), bytes, &LoadOptions::default())
    }

    #[test]
    fn both_kinds_are_read() {
        let part = read_bytes(ASCII.as_bytes()).unwrap();
        assert_eq!(part.triangles, [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(part.vertices[5], DVec3::new(0.0, 2.0, 0.0));
        let facet = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.5];
        let part = read_bytes(&binary_file(&[facet, facet])).unwrap();
        assert_eq!(part.triangles.len(), 2);
        assert_eq!(part.vertices[5], DVec3::new(0.0, 1.0, 0.5));
    }

    #[test]
    fn broken_files_are_refused() {
        let mut bomb = binary_file(&[]);
        bomb[..5].copy_from_slice(b"bomb!");
        bomb[80..].copy_from_slice(&u32::MAX.to_le_bytes());
        let nan = binary_file(&[[f32::NAN; 9]]);
        let cut = ASCII.split_once("endsolid").unwrap().0.as_bytes();
        for (bytes, word) in [
            (&b""[..], "neither"),
            (&bomb, "declared"),
            (&nan, "facet 0"),
            (cut, "cut off"),
            (b"solid x\nvertex 1 2 y", "line 2: 'y'"),
            (b"solid x\nvertex 1 2 3\nendloop", "line 3: a loop of 1"),
        ] {
            let message = read_bytes(bytes).unwrap_err().to_string();
            assert!(message.contains(word), "{message}");
        }
    }
}
