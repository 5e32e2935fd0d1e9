//! Triangles of one file or shape in their own frame, before they are placed in the world.
use glam::{DMat4, DVec3, DVec4};

use super::UpAxis;

/// In f64: whether a sliver is degenerate must not depend on where in the world it stands.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Part {
    pub vertices: Vec<DVec3>,
    /// Indices are below `vertices.len()`.
    pub triangles: Vec<[u32; 3]>,
}

impl Part {
    /// Adds a vertex, unless it is not finite.
    pub fn push_vertex(&mut self, vertex: DVec3) -> Result<(), String> {
        if !vertex.is_finite() {
            return Err(format!("vertex {} is {vertex}", self.vertices.len()));
        }
        self.vertices.push(vertex);
        Ok(())
    }

    /// Adds a polygon with these corners as a fan, if all exist and the limit permits it.
    pub fn push_polygon(&mut self, corners: &[u32], max_triangles: usize) -> Result<(), String> {
        if let Some(index) = corners.iter().find(|i| **i as usize >= self.vertices.len()) {
            let count = self.vertices.len();
            return Err(format!("index {index}, but there are {count} vertices"));
        }
        if self.triangles.len() + corners.len().saturating_sub(2) > max_triangles {
            return Err(format!("more than {max_triangles} triangles"));
        }
        let pairs = corners.windows(2).skip(1);
        self.triangles
            .extend(pairs.map(|pair| [corners[0], pair[0], pair[1]]));
        Ok(())
    }

    /// Adds another part under a transform.
    pub fn append(
        &mut self,
        part: &Part,
        transform: DMat4,
        max_triangles: usize,
    ) -> Result<(), String> {
        let triangles = self.triangles.len() + part.triangles.len();
        let vertices = self.vertices.len() + part.vertices.len();
        if triangles > max_triangles || vertices > 3 * max_triangles || vertices > u32::MAX as usize
        {
            return Err(format!("more than {max_triangles} triangles"));
        }
        let base = self.vertices.len() as u32;
        let moved = part.vertices.iter().map(|v| transform.transform_point3(*v));
        self.vertices.extend(moved);
        let shifted = part.triangles.iter().map(|t| t.map(|i| i + base));
        self.triangles.extend(shifted);
        Ok(())
    }
}

/// The rotation that makes z point up.
pub(super) fn z_up_from(up: UpAxis) -> DMat4 {
    let (x, y, z) = (DVec4::X, DVec4::Y, DVec4::Z);
    match up {
        UpAxis::X => DMat4::from_cols(z, -x, -y, DVec4::W),
        UpAxis::Y => DMat4::from_cols(x, z, -y, DVec4::W),
        UpAxis::Z => DMat4::IDENTITY,
    }
}
