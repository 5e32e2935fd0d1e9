//! An 8-wide bounding volume hierarchy over triangles in blocks of 8, read by the ray kernels and the rasteriser.
//!
//! Built as a binary tree by obvhs (PLOC with reinsertion) and collapsed: a node takes in the largest of its
//! descendants until it has 8 children. Blocks lie in depth-first order, so that every subtree owns one range of them.
mod stored;

use crate::geometry::{Mesh, Vec3};
use obvhs::bvh2::{builder::build_bvh2_from_tris, Bvh2};
use obvhs::{triangle::Triangle, BvhBuildParams};

/// Children of a node and triangles of a block.
pub const WIDTH: usize = 8;
/// Entries of a traversal stack: each level leaves at most 7 siblings behind.
pub const STACK: usize = (WIDTH - 1) * MAX_DEPTH + WIDTH;
/// Deeper than this a binary tree (of, say, a million equal triangles) is not followed but split evenly.
const MAX_BINARY_DEPTH: usize = 14;
/// Even splits add at most this: 8^10 blocks.
const MAX_DEPTH: usize = MAX_BINARY_DEPTH + 10;
const INNER: u32 = 1 << 31;

/// Bounds of the 8 children, by axis; an empty child has the bounds +inf, -inf.
#[derive(Clone)]
#[repr(C, align(64))]
pub struct Node {
    pub lower: [[f32; WIDTH]; 3],
    pub upper: [[f32; WIDTH]; 3],
    pub children: [Child; WIDTH],
}

/// An inner child (`index` is its node) or a leaf (`index` is its first block); `count` blocks lie below it.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub struct Child {
    pub index: u32,
    tagged_count: u32,
}

impl Child {
    #[inline(always)]
    pub fn is_leaf(self) -> bool {
        self.tagged_count & INNER == 0
    }
    #[inline(always)]
    pub fn count(self) -> u32 {
        self.tagged_count & !INNER
    }
}

/// Up to 8 triangles: `corner[i][axis][lane]`. Unused lanes are NaN, which no test accepts.
#[derive(Clone)]
#[repr(C, align(64))]
pub struct Block {
    pub corner: [[[f32; WIDTH]; 3]; 3],
}

impl Block {
    const EMPTY: Block = Block {
        corner: [[[f32::NAN; WIDTH]; 3]; 3],
    };
}

#[derive(Clone, Default)]
pub struct Bvh {
    /// The root is node 0; no nodes if there are no triangles.
    pub nodes: Vec<Node>,
    /// First block below each node.
    pub first_block: Vec<u32>,
    pub blocks: Vec<Block>,
}

impl Bvh {
    /// Triangles that name missing vertices or have coordinates beyond 1e9 m (or NaN) are left out.
    pub fn new(mesh: &Mesh) -> Self {
        let mut bvh = Bvh::default();
        let triangles: Vec<[Vec3; 3]> = mesh
            .triangles
            .iter()
            .filter_map(|t| {
                let corner = |i: u32| mesh.vertices.get(i as usize).copied();
                let corners = [corner(t[0])?, corner(t[1])?, corner(t[2])?];
                corners
                    .iter()
                    .all(|p| p.abs().cmple(Vec3::splat(MAX_CORNER)).all())
                    .then_some(corners)
            })
            .collect();
        if triangles.is_empty() {
            return bvh;
        }
        let binary = Binary::build(&triangles);
        Collapse {
            triangles: &triangles,
            binary: &binary,
            evenly_split: Vec::new(),
            bvh: &mut bvh,
        }
        .run();
        bvh
    }

    pub fn memory_bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<Node>()
            + self.first_block.capacity() * 4
            + self.blocks.capacity() * size_of::<Block>()
    }
}

/// Corners beyond this are not taken in, metres.
const MAX_CORNER: f32 = 1e9;

/// The binary tree in our own glam.
struct Binary {
    tree: Bvh2,
}

impl Binary {
    fn build(triangles: &[[Vec3; 3]]) -> Self {
        let theirs: Vec<Triangle> = triangles
            .iter()
            .map(|t| Triangle {
                v0: t[0].to_array().into(),
                v1: t[1].to_array().into(),
                v2: t[2].to_array().into(),
            })
            .collect();
        let mut params = BvhBuildParams::medium_build();
        params.max_prims_per_leaf = WIDTH as u32;
        Self {
            tree: build_bvh2_from_tris(&theirs, params, &mut Default::default()),
        }
    }

    fn is_leaf(&self, node: u32) -> bool {
        self.tree.nodes[node as usize].prim_count > 0
    }

    fn children(&self, node: u32) -> [u32; 2] {
        let first = self.tree.nodes[node as usize].first_index;
        [first, first + 1]
    }

    fn primitives(&self, leaf: u32) -> &[u32] {
        let n = &self.tree.nodes[leaf as usize];
        &self.tree.primitive_indices
            [n.first_index as usize..(n.first_index + n.prim_count) as usize]
    }

    fn half_area(&self, node: u32) -> f32 {
        self.tree.nodes[node as usize].aabb().half_area()
    }

    fn primitives_below(&self, node: u32, into: &mut Vec<u32>) {
        let mut todo = vec![node];
        while let Some(n) = todo.pop() {
            if self.is_leaf(n) {
                into.extend_from_slice(self.primitives(n));
            } else {
                todo.extend(self.children(n));
            }
        }
    }
}

/// What becomes a child: a node of the binary tree, or a range of `Collapse::evenly_split`.
#[derive(Clone, Copy)]
enum Source {
    Node(u32),
    Range(usize, usize),
}

struct Task {
    source: Source,
    /// Node and lane that wait for this child.
    parent: Option<(usize, usize)>,
    depth: usize,
}

struct Collapse<'a> {
    triangles: &'a [[Vec3; 3]],
    binary: &'a Binary,
    evenly_split: Vec<u32>,
    bvh: &'a mut Bvh,
}

impl Collapse<'_> {
    fn run(mut self) {
        // Depth first with an explicit stack: a degenerate tree must not overflow the thread's.
        let mut todo = vec![Task {
            source: Source::Node(0),
            parent: None,
            depth: 0,
        }];
        while let Some(task) = todo.pop() {
            let leaf: Option<Vec<u32>> = match task.source {
                Source::Node(n) if self.binary.is_leaf(n) => {
                    Some(self.binary.primitives(n).to_vec())
                }
                Source::Range(from, to) if to - from <= WIDTH => {
                    Some(self.evenly_split[from..to].to_vec())
                }
                _ => None,
            };
            // The root is always a node, so that kernels need no special case.
            if let (Some(primitives), Some((node, lane))) = (&leaf, task.parent) {
                let index = self.bvh.blocks.len() as u32;
                self.emit(primitives);
                self.bvh.nodes[node].children[lane] = Child {
                    index,
                    tagged_count: self.bvh.blocks.len() as u32 - index,
                };
                continue;
            }
            let index = self.bvh.nodes.len();
            self.bvh.nodes.push(Node {
                lower: [[f32::INFINITY; WIDTH]; 3],
                upper: [[f32::NEG_INFINITY; WIDTH]; 3],
                children: [Child::default(); WIDTH],
            });
            self.bvh.first_block.push(self.bvh.blocks.len() as u32);
            if let Some((node, lane)) = task.parent {
                self.bvh.nodes[node].children[lane] = Child {
                    index: index as u32,
                    tagged_count: INNER,
                };
            }
            let children = if leaf.is_some() {
                vec![task.source]
            } else {
                self.children_of(task.source, task.depth)
            };
            for (lane, &child) in children.iter().enumerate() {
                let (lower, upper) = self.bounds(child);
                for axis in 0..3 {
                    self.bvh.nodes[index].lower[axis][lane] = lower[axis];
                    self.bvh.nodes[index].upper[axis][lane] = upper[axis];
                }
            }
            // Reversed, so that children are taken from the stack in lane order.
            todo.extend(
                children
                    .iter()
                    .enumerate()
                    .rev()
                    .map(|(lane, &source)| Task {
                        source,
                        parent: Some((index, lane)),
                        depth: task.depth + 1,
                    }),
            );
        }
        // Children have larger numbers than their parents: one backward pass sums the blocks of subtrees.
        let mut below = vec![0u32; self.bvh.nodes.len()];
        for n in (0..self.bvh.nodes.len()).rev() {
            for child in &mut self.bvh.nodes[n].children {
                if !child.is_leaf() {
                    child.tagged_count = INNER | below[child.index as usize];
                }
                below[n] += child.count();
            }
        }
    }

    fn children_of(&mut self, source: Source, depth: usize) -> Vec<Source> {
        let node = match source {
            Source::Range(from, to) => {
                let n = to - from;
                return (0..WIDTH)
                    .map(|k| Source::Range(from + n * k / WIDTH, from + n * (k + 1) / WIDTH))
                    .filter(|s| matches!(s, Source::Range(a, b) if a < b))
                    .collect();
            }
            Source::Node(node) => node,
        };
        if depth >= MAX_BINARY_DEPTH {
            let from = self.evenly_split.len();
            self.binary.primitives_below(node, &mut self.evenly_split);
            return self.children_of(Source::Range(from, self.evenly_split.len()), depth);
        }
        let mut list = self.binary.children(node).to_vec();
        while list.len() < WIDTH {
            let largest = (0..list.len())
                .filter(|&k| !self.binary.is_leaf(list[k]))
                .max_by(|&a, &b| {
                    self.binary
                        .half_area(list[a])
                        .total_cmp(&self.binary.half_area(list[b]))
                });
            let Some(k) = largest else { break };
            let [first, second] = self.binary.children(list[k]);
            list[k] = first;
            list.push(second);
        }
        list.into_iter().map(Source::Node).collect()
    }

    fn bounds(&self, source: Source) -> (Vec3, Vec3) {
        match source {
            Source::Node(n) => {
                let bounds = self.binary.tree.nodes[n as usize].aabb();
                (
                    Vec3::new(bounds.min.x, bounds.min.y, bounds.min.z),
                    Vec3::new(bounds.max.x, bounds.max.y, bounds.max.z),
                )
            }
            Source::Range(from, to) => self.evenly_split[from..to]
                .iter()
                .flat_map(|&p| self.triangles[p as usize])
                .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lower, upper), p| {
                    (lower.min(p), upper.max(p))
                }),
        }
    }

    fn emit(&mut self, primitives: &[u32]) {
        for chunk in primitives.chunks(WIDTH) {
            let mut block = Block::EMPTY;
            for (lane, &p) in chunk.iter().enumerate() {
                for (corner, point) in self.triangles[p as usize].iter().enumerate() {
                    for axis in 0..3 {
                        block.corner[corner][axis][lane] = point[axis];
                    }
                }
            }
            self.bvh.blocks.push(block);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::test_scenes::*;
    use std::collections::BTreeMap;

    fn key(corners: [[f32; 3]; 3]) -> [[u32; 3]; 3] {
        corners.map(|c| c.map(f32::to_bits))
    }

    /// Every triangle lies in exactly one block, inside all boxes above it; ranges and depth are as promised.
    fn check(mesh: &Mesh) {
        let bvh = Bvh::new(mesh);
        let mut left: BTreeMap<_, i64> = BTreeMap::new();
        for t in 0..mesh.triangles.len() {
            *left
                .entry(key(mesh.corners(t).map(|p| p.to_array())))
                .or_default() += 1;
        }
        let mut covered = vec![0u32; bvh.blocks.len()];
        let mut todo = vec![(0usize, [f32::NEG_INFINITY; 3], [f32::INFINITY; 3], 0)];
        while let Some((n, lower, upper, depth)) = if bvh.nodes.is_empty() {
            None
        } else {
            todo.pop()
        } {
            assert!(depth < MAX_DEPTH);
            let mut next = bvh.first_block[n];
            for (lane, child) in bvh.nodes[n].children.iter().enumerate() {
                let lo: [f32; 3] = std::array::from_fn(|a| bvh.nodes[n].lower[a][lane]);
                let hi: [f32; 3] = std::array::from_fn(|a| bvh.nodes[n].upper[a][lane]);
                if child.count() == 0 {
                    assert!(lo == [f32::INFINITY; 3] && hi == [f32::NEG_INFINITY; 3]);
                    continue;
                }
                assert!((0..3).all(|a| lower[a] <= lo[a] && lo[a] <= hi[a] && hi[a] <= upper[a]));
                if !child.is_leaf() {
                    assert_eq!(bvh.first_block[child.index as usize], next);
                    todo.push((child.index as usize, lo, hi, depth + 1));
                } else {
                    assert_eq!(child.index, next);
                    for b in child.index..child.index + child.count() {
                        covered[b as usize] += 1;
                        let block = &bvh.blocks[b as usize];
                        for l in 0..WIDTH {
                            let corners: [[f32; 3]; 3] = std::array::from_fn(|c| {
                                std::array::from_fn(|a| block.corner[c][a][l])
                            });
                            if corners[0][0].is_nan() {
                                continue;
                            }
                            assert!(corners
                                .iter()
                                .all(|c| (0..3).all(|a| lo[a] <= c[a] && c[a] <= hi[a])));
                            *left.entry(key(corners)).or_default() -= 1;
                        }
                    }
                }
                next += child.count();
            }
        }
        assert!(left.values().all(|&n| n == 0));
        assert!(covered.iter().all(|&n| n == 1));
    }

    #[test]
    fn holds_every_triangle_once() {
        check(&Mesh::default());
        for n in [1, 2, 3, 7, 8, 9, 17, 64, 65, 1000] {
            check(&soup(n, 7 + n as u64));
        }
        check(&room(0.3));
    }

    #[test]
    fn bounded_depth_for_equal_triangles() {
        let one = soup(1, 3);
        let mut many = Mesh::default();
        for _ in 0..20_000 {
            many.append(&one);
        }
        check(&many);
        // A row of triangles whose size doubles: the worst tree for a bottom-up builder.
        let mut spiral = Mesh::default();
        for i in 0..60 {
            let s = 1.3f32.powi(i);
            let v = spiral.vertices.len() as u32;
            spiral.vertices.extend([
                Vec3::ZERO,
                Vec3::new(s, 0.0, 0.1),
                Vec3::new(0.0, s, 0.2 * s),
            ]);
            spiral.triangles.push([v, v + 1, v + 2]);
        }
        check(&spiral);
    }

    #[test]
    fn leaves_out_what_is_not_a_triangle() {
        let mut mesh = soup(4, 1);
        mesh.vertices.push(Vec3::new(f32::NAN, 0.0, 0.0));
        mesh.vertices.push(Vec3::new(f32::INFINITY, 0.0, 0.0));
        let n = mesh.vertices.len() as u32;
        mesh.triangles
            .extend([[0, 1, n - 1], [0, 1, n - 2], [0, 1, n + 5]]);
        let kept: usize = Bvh::new(&mesh)
            .blocks
            .iter()
            .map(|b| b.corner[0][0].iter().filter(|x| !x.is_nan()).count())
            .sum();
        assert_eq!(kept, 4);
    }
}
