//! The primitives of a COLLADA mesh: index lists of triangles, polygons, fans and strips.
use roxmltree::Node;

use super::part::Part;
use super::text::{child, content, line, numbers};

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    Triangles,
    Polylist,
    Polygons,
    Fans,
    Strips,
}

impl Kind {
    /// None for what has no area and for what is no primitive.
    pub fn of(element: Node) -> Option<Self> {
        match element.tag_name().name() {
            "triangles" => Some(Self::Triangles),
            "polylist" => Some(Self::Polylist),
            "polygons" => Some(Self::Polygons),
            "trifans" => Some(Self::Fans),
            "tristrips" => Some(Self::Strips),
            _ => None,
        }
    }
}

/// How the index list of a primitive is laid out.
pub(super) struct Faces {
    pub kind: Kind,
    /// Numbers per corner, and which of them is the position's index.
    pub stride: usize,
    pub offset: usize,
    /// The positions of the primitive's source: the first in the part, and how many.
    pub base: u32,
    pub count: u32,
}

impl Faces {
    /// Adds the triangles of a primitive; its positions are in `part` already.
    pub fn read(
        &self,
        primitive: Node,
        part: &mut Part,
        max_triangles: usize,
    ) -> Result<(), String> {
        let counts: Vec<usize> = match child(primitive, "vcount") {
            Some(vcount) => numbers(content(vcount)).map_err(|w| format!("vcount holds '{w}'"))?,
            None => Vec::new(),
        };
        let mut push = |corners: &[u32]| part.push_polygon(corners, max_triangles);
        // Those with holes have theirs one level deeper, in <ph>; the holes are filled.
        for run in primitive
            .descendants()
            .filter(|n| n.tag_name().name() == "p")
        {
            let indices = self
                .indices(content(run))
                .map_err(|message| format!("line {}: {message}", line(run)))?;
            match self.kind {
                Kind::Triangles if indices.len() % 3 != 0 => {
                    return Err(format!("{} indices are no triangles", indices.len()));
                }
                Kind::Triangles => indices.chunks_exact(3).try_for_each(&mut push)?,
                Kind::Polylist => {
                    let mut rest = indices.as_slice();
                    for &count in &counts {
                        if count > rest.len() {
                            return Err("<p> is shorter than <vcount> says".to_owned());
                        }
                        let (polygon, tail) = rest.split_at(count);
                        push(polygon)?;
                        rest = tail;
                    }
                }
                Kind::Polygons | Kind::Fans => push(&indices)?,
                Kind::Strips => indices.windows(3).enumerate().try_for_each(|(i, t)| {
                    let (a, b) = if i % 2 == 0 {
                        (t[0], t[1])
                    } else {
                        (t[1], t[0])
                    };
                    push(&[a, b, t[2]])
                })?,
            }
        }
        Ok(())
    }

    /// The position indices in `<p>`, checked against the number of positions.
    fn indices(&self, text: &str) -> Result<Vec<u32>, String> {
        let mut indices = Vec::new();
        let mut words = 0;
        for word in text.split_ascii_whitespace() {
            if words % self.stride == self.offset {
                let index: u32 = word
                    .parse()
                    .map_err(|_| format!("index '{word}' is not a number"))?;
                if index >= self.count {
                    return Err(format!(
                        "index {index}, but there are {} vertices",
                        self.count
                    ));
                }
                indices.push(index + self.base);
            }
            words += 1;
        }
        if words % self.stride != 0 {
            return Err(format!("{words} indices in groups of {}", self.stride));
        }
        Ok(indices)
    }
}
