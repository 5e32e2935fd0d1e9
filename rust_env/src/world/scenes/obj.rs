//! Wavefront OBJ: vertices and faces. Own reader: materials, normals and texture coordinates, which a general one
//! insists on, are none of our business, and its messages do not name the line.
use std::path::Path;

use glam::DVec3;

use super::part::Part;
use super::LoadOptions;
use crate::error::{Error, Result};

pub(super) fn read(path: &Path, bytes: &[u8], options: &LoadOptions) -> Result<Part> {
    let mut part = Part::default();
    // A line that ends with a backslash goes on in the next one.
    let mut joined: Vec<u8> = Vec::new();
    for (number, line) in bytes.split(|b| *b == b'\n').enumerate() {
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        if let Some(start) = line.strip_suffix(b"\\") {
            joined.extend_from_slice(start);
            joined.push(b' ');
            continue;
        }
        let result = if joined.is_empty() {
            statement(line, &mut part, options)
        } else {
            joined.extend_from_slice(line);
            let result = statement(&joined, &mut part, options);
            joined.clear();
            result
        };
        result
            .map_err(|message| Error::malformed(path, format!("line {}: {message}", number + 1)))?;
    }
    Ok(part)
}

fn statement(
    line: &[u8],
    part: &mut Part,
    options: &LoadOptions,
) -> std::result::Result<(), String> {
    // Names of objects and materials may be in any encoding; the two statements that matter are ASCII.
    let line = line.trim_ascii_start();
    let (vertex, rest) = match line {
        [b'v', b' ' | b'\t', rest @ ..] => (true, rest),
        [b'f', b' ' | b'\t', rest @ ..] => (false, rest),
        _ => return Ok(()),
    };
    let rest = std::str::from_utf8(rest).map_err(|_| "not text".to_owned())?;
    let rest = rest.split('#').next().unwrap_or("");
    let mut words = rest.split_ascii_whitespace();
    if vertex {
        let mut coordinate = || {
            let word = words.next().ok_or("a vertex needs three coordinates")?;
            word.parse::<f64>()
                .map_err(|_| format!("'{word}' is not a number"))
        };
        // A fourth number is a weight for curves, six are a colour.
        let vertex = DVec3::new(coordinate()?, coordinate()?, coordinate()?);
        if part.vertices.len() >= 3 * options.max_triangles {
            return Err(format!("more than {} vertices", 3 * options.max_triangles));
        }
        return part.push_vertex(vertex);
    }
    let count = part.vertices.len() as i64;
    let corners: Vec<u32> = words
        .map(|word| {
            let number = word.split('/').next().unwrap_or("");
            // From 1, or from the end if negative.
            match number.parse::<i64>() {
                Ok(index) if (1..=count).contains(&index) => Ok(index as u32 - 1),
                Ok(index) if (-count..=-1).contains(&index) => Ok((count + index) as u32),
                _ => Err(format!("'{word}' is none of {count} vertices so far")),
            }
        })
        .collect::<std::result::Result<_, _>>()?;
    part.push_polygon(&corners, options.max_triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<Part> {
        read(Path::new("a.obj"), text.as_bytes(), &LoadOptions::default())
    }

    #[test]
    fn faces_of_any_spelling() {
        let text =
            "# cube\no é\nv 0 0 0\r\nv 1 0 0 1 0 0\nv 1 1 0 1\n\tv 0 1 0\nvn 0 0 1\nusemtl x\n\
                    f 1/1/1 2//1 3/2 4 # quad\nf -4 -3 \\\n -2\nl 1 2\n";
        let part = read_text(text).unwrap();
        assert_eq!(part.vertices.len(), 4);
        assert_eq!(part.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
    }

    #[test]
    fn broken_lines_are_named() {
        for (text, line, word) in [
            ("v 0 0\n", 1, "three coordinates"),
            ("v 0 0 x\n", 1, "'x'"),
            ("v 0 0 0\nv nan 0 0", 2, "NaN"),
            ("v 0 0 0\nf 1 1 2\n", 2, "'2'"),
            ("v 0 0 0\nf 1 1 0\n", 2, "'0'"),
            ("v 0 0 0\nf 1 1 -2\n", 2, "'-2'"),
            (
                "v 0 0 0\nf 1 99999999999999999999 1\n",
                2,
                "99999999999999999999",
            ),
        ] {
            let message = read_text(text).unwrap_err().to_string();
            assert!(message.contains(&format!("line {line}: ")), "{message}");
            assert!(message.contains(word), "{message}");
        }
    }

    #[test]
    fn too_many_triangles_are_refused() {
        let options = LoadOptions {
            max_triangles: 1,
            ..LoadOptions::default()
        };
        let text = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3 1";
        assert!(read(Path::new("a.obj"), text, &options).is_err());
    }
}
