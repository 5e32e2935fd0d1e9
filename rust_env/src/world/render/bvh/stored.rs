//! A hierarchy as bytes, for a cache that need not be trusted.
use super::{Block, Bvh, Child, Node, MAX_CORNER, MAX_DEPTH, WIDTH};
use crate::world::bytes::{floats, Fault, Reader, Writer};

/// Bytes of a child, a node and a block.
const CHILD_BYTES: usize = 8;
const NODE_BYTES: usize = 4 * 6 * WIDTH + CHILD_BYTES * WIDTH + 4;
const BLOCK_BYTES: usize = 4 * 9 * WIDTH;

impl Bvh {
    pub fn write(&self, out: &mut Writer) {
        out.0
            .reserve(16 + NODE_BYTES * self.nodes.len() + BLOCK_BYTES * self.blocks.len());
        out.u64(self.nodes.len() as u64);
        for (node, first) in self.nodes.iter().zip(&self.first_block) {
            let bounds = node.lower.iter().chain(&node.upper);
            bounds.flatten().for_each(|x| out.f32(*x));
            for child in &node.children {
                out.u32(child.index);
                out.u32(child.tagged_count);
            }
            out.u32(*first);
        }
        out.u64(self.blocks.len() as u64);
        for block in &self.blocks {
            let corners = block.corner.as_flattened().as_flattened();
            corners.iter().for_each(|x| out.f32(*x));
        }
    }

    /// What [`Bvh::write`] wrote; whatever the bytes, traversal of what is returned ends and stays within it.
    pub fn read(from: &mut Reader) -> Result<Self, Fault> {
        let count = from.count(NODE_BYTES)?;
        let mut bvh = Self::default();
        for _ in 0..count {
            let mut bounds = floats::<WIDTH>(from.take(4 * 6 * WIDTH)?);
            let mut axis = || bounds.next().unwrap_or([f32::NAN; WIDTH]);
            let lower = [axis(), axis(), axis()];
            let upper = [axis(), axis(), axis()];
            let mut children = [Child::default(); WIDTH];
            for child in &mut children {
                child.index = from.u32()?;
                child.tagged_count = from.u32()?;
            }
            bvh.nodes.push(Node {
                lower,
                upper,
                children,
            });
            bvh.first_block.push(from.u32()?);
        }
        let count = from.count(BLOCK_BYTES)?;
        let corners = floats::<{ 9 * WIDTH }>(from.take(count * BLOCK_BYTES)?);
        bvh.blocks = corners
            .map(|flat| {
                let mut block = Block::EMPTY;
                block
                    .corner
                    .as_flattened_mut()
                    .as_flattened_mut()
                    .copy_from_slice(&flat);
                block
            })
            .collect();
        bvh.check()?;
        Ok(bvh)
    }

    /// Every block lies below exactly one leaf, in order; children come after their parents, lie within them and not too deep.
    fn check(&self) -> Result<(), Fault> {
        let corners = self.blocks.iter().flat_map(|b| b.corner.as_flattened());
        if corners.flatten().any(|x| x.abs() > MAX_CORNER) {
            return Err("a corner out of range");
        }
        if self.nodes.is_empty() {
            return match self.blocks.is_empty() {
                true => Ok(()),
                false => Err("blocks without nodes"),
            };
        }
        // Node, its range of blocks, its depth.
        let mut todo = vec![(0usize, 0u32, self.blocks.len() as u64, 0usize)];
        while let Some((n, first, end, depth)) = todo.pop() {
            if depth >= MAX_DEPTH || self.first_block[n] != first {
                return Err("a node out of place");
            }
            let node = &self.nodes[n];
            let mut next = u64::from(first);
            for (lane, child) in node.children.iter().enumerate() {
                for axis in 0..3 {
                    let (lower, upper) = (node.lower[axis][lane], node.upper[axis][lane]);
                    let empty = lower == f32::INFINITY && upper == f32::NEG_INFINITY;
                    let sound =
                        lower.abs() <= MAX_CORNER && upper.abs() <= MAX_CORNER && lower <= upper;
                    if empty != (child.count() == 0) || !(empty || sound) {
                        return Err("a node with unsound bounds");
                    }
                }
                if child.count() == 0 {
                    if !child.is_leaf() {
                        return Err("a node without blocks");
                    }
                    continue;
                }
                let index = child.index as usize;
                if child.is_leaf() {
                    if index as u64 != next {
                        return Err("a leaf out of place");
                    }
                } else if index > n && index < self.nodes.len() {
                    let end = next + u64::from(child.count());
                    todo.push((index, next as u32, end, depth + 1));
                } else {
                    return Err("a child out of place");
                }
                next += u64::from(child.count());
            }
            if next != end {
                return Err("a node with too few or too many blocks");
            }
        }
        Ok(())
    }
}
