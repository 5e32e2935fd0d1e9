//! One ray against the hierarchy: 8 boxes, then 8 triangles at a time.
//!
//! The triangle test is the watertight one of Woop, Benthin and Wald (JCGT 2013): the ray becomes the z axis by a
//! shear, and the sign of each edge function is the same seen from both triangles at an edge, so that no ray slips
//! between them.
use super::bvh::{Block, Bvh, Child, Node};
use super::simd::{Kernel, Lanes, Simd};
use super::view::View;
use crate::geometry::Vec3;

/// Slab distances are widened by this factor, so that rounding never loses a box that a ray touches
/// (Ize, "Robust BVH ray traversal", JCGT 2013).
pub const WIDEN: f32 = 1.0 + 4.0 * f32::EPSILON;

#[derive(Clone, Copy, Default)]
pub struct Entry {
    /// Where the ray enters the child's box.
    pub distance: f32,
    pub child: Child,
}

/// Sorts the children in `hits` (bits) into the stack, farthest first, and returns the nearest.
#[inline(always)]
pub fn push_sorted(
    todo: &mut [Entry],
    top: &mut usize,
    mut hits: u32,
    distances: &[f32; 8],
    children: &[Child; 8],
) -> Entry {
    let lane = (hits.trailing_zeros() & 7) as usize;
    let mut nearest = Entry {
        distance: distances[lane],
        child: children[lane],
    };
    hits &= hits - 1;
    let bottom = *top;
    while hits != 0 {
        let lane = (hits.trailing_zeros() & 7) as usize;
        let mut e = Entry {
            distance: distances[lane],
            child: children[lane],
        };
        hits &= hits - 1;
        if e.distance < nearest.distance {
            std::mem::swap(&mut e, &mut nearest);
        }
        let mut i = *top;
        while i > bottom && todo[i - 1].distance < e.distance {
            todo[i] = todo[i - 1];
            i -= 1;
        }
        todo[i] = e;
        *top += 1;
    }
    nearest
}

/// Distance to the first triangle along `direction` (any length; in units of it) before `limit`.
pub struct Cast<'a> {
    pub bvh: &'a Bvh,
    pub origin: Vec3,
    pub direction: Vec3,
    pub limit: f32,
    pub todo: &'a mut [Entry],
}

impl Kernel for Cast<'_> {
    type Output = Option<f32>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Option<f32> {
        let ray = Ray::new(lanes.s8(), self.origin, self.direction);
        let t = ray.trace(lanes.s8(), self.bvh, self.limit, self.todo);
        if t < self.limit {
            Some(t)
        } else {
            None
        }
    }
}

/// Renders `view` into `out` (row-major), ray by ray.
pub struct Rays<'a> {
    pub bvh: &'a Bvh,
    pub view: &'a View<'a>,
    pub todo: &'a mut [Entry],
    pub out: &'a mut [f32],
}

impl Kernel for Rays<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let (s, view, camera) = (lanes.s8(), self.view, self.view.camera);
        for v in 0..camera.height {
            for start in (0..camera.width).step_by(8) {
                // Depth conversion in 8 lanes, of which those beyond the image are not used.
                let mut columns = [0.0; 8];
                for (lane, column) in columns.iter_mut().enumerate() {
                    *column = view.x((start + lane) as f32 + 0.5);
                }
                let (x, y) = (s.load(&columns), s.splat(view.y(v as f32 + 0.5)));
                let mut depths = [0.0; 8];
                s.store(view.limit(s, x, y), &mut depths);
                let wide = (camera.width - start).min(8);
                for (lane, depth) in depths.iter_mut().enumerate().take(wide) {
                    let direction = view.direction((start + lane) as f32 + 0.5, v as f32 + 0.5);
                    let ray = Ray::new(s, view.origin, direction);
                    *depth = ray.trace(s, self.bvh, *depth, self.todo);
                }
                let z = s.load(&depths);
                s.store(view.depth(s, z, x, y), &mut depths);
                let to = v * camera.width + start;
                self.out[to..to + wide].copy_from_slice(&depths[..wide]);
            }
        }
    }
}

struct Ray<S: Simd> {
    origin: [S::F; 3],
    direction: [S::F; 3],
    inverse: [S::F; 3],
    negative: [bool; 3],
    /// Axes in the order of the sheared frame; the last is the largest of the direction.
    axes: [usize; 3],
    shear: [S::F; 2],
}

/// 1 / d; a zero would give 0 * inf = NaN in the slab test.
#[inline(always)]
fn inverse(d: f32) -> f32 {
    1.0 / if d.abs() < 1e-20 {
        1e-20f32.copysign(d)
    } else {
        d
    }
}

impl<S: Simd> Ray<S> {
    #[inline(always)]
    fn new(s: S, origin: Vec3, direction: Vec3) -> Self {
        let [x, y, z] = direction.to_array();
        let inverse = [inverse(x), inverse(y), inverse(z)];
        let last = if x.abs() > y.abs() && x.abs() > z.abs() {
            0
        } else if y.abs() > z.abs() {
            1
        } else {
            2
        };
        let axes = [(last + 1) % 3, (last + 2) % 3, last];
        let along = direction[last];
        Self {
            origin: s.splat3(origin.to_array()),
            direction: s.splat3(direction.to_array()),
            inverse: s.splat3(inverse),
            negative: [inverse[0] < 0.0, inverse[1] < 0.0, inverse[2] < 0.0],
            axes,
            shear: [
                s.splat(direction[axes[0]] / along),
                s.splat(direction[axes[1]] / along),
            ],
        }
    }

    /// Distance to the first triangle before `limit`, else `limit`.
    #[inline(always)]
    fn trace(&self, s: S, bvh: &Bvh, limit: f32, todo: &mut [Entry]) -> f32 {
        let Some(mut node) = bvh.nodes.first() else {
            return limit;
        };
        let mut limit = limit;
        let mut top = 0;
        'next: loop {
            // Down from `node` along the nearest children.
            loop {
                let (hits, distances) = self.enter_boxes(s, node, limit);
                if hits == 0 {
                    break;
                }
                let nearest = push_sorted(todo, &mut top, hits, &distances, &node.children);
                if nearest.child.is_leaf() {
                    limit = self.hit_leaf(s, bvh, nearest.child, limit);
                    break;
                }
                node = &bvh.nodes[nearest.child.index as usize];
            }
            while top > 0 {
                top -= 1;
                let entry = todo[top];
                if entry.distance >= limit {
                    continue;
                }
                if !entry.child.is_leaf() {
                    node = &bvh.nodes[entry.child.index as usize];
                    continue 'next;
                }
                limit = self.hit_leaf(s, bvh, entry.child, limit);
            }
            return limit;
        }
    }

    /// Which of 8 boxes the ray enters before `limit`, and where.
    #[inline(always)]
    fn enter_boxes(&self, s: S, node: &Node, limit: f32) -> (u32, [f32; 8]) {
        let mut near = s.zero();
        let mut far = s.splat(limit);
        for axis in 0..3 {
            let (first, second) = if self.negative[axis] {
                (&node.upper[axis], &node.lower[axis])
            } else {
                (&node.lower[axis], &node.upper[axis])
            };
            let enter = s.mul(s.sub(s.load(first), self.origin[axis]), self.inverse[axis]);
            let leave = s.mul(s.sub(s.load(second), self.origin[axis]), self.inverse[axis]);
            near = s.max(enter, near);
            far = s.min(leave, far);
        }
        let hits = s.bits(s.le(near, s.mul(far, s.splat(WIDEN))));
        let mut distances = [0.0; 8];
        s.store(near, &mut distances);
        (hits, distances)
    }

    /// The nearest hit in a leaf before `limit`, else `limit`.
    #[inline(always)]
    fn hit_leaf(&self, s: S, bvh: &Bvh, leaf: Child, limit: f32) -> f32 {
        let mut limit = limit;
        for block in &bvh.blocks[leaf.index as usize..(leaf.index + leaf.count()) as usize] {
            limit = self.hit_block(s, block, limit);
        }
        limit
    }

    #[inline(always)]
    fn hit_block(&self, s: S, block: &Block, limit: f32) -> f32 {
        let a = self.sheared(s, &block.corner[0]);
        let b = self.sheared(s, &block.corner[1]);
        let c = self.sheared(s, &block.corner[2]);
        let (u, v, w) = (edge(s, c, b), edge(s, a, c), edge(s, b, a));
        let zero = s.zero();
        let front = s.and(s.le(zero, u), s.and(s.le(zero, v), s.le(zero, w)));
        let back = s.and(s.le(u, zero), s.and(s.le(v, zero), s.le(w, zero)));
        let inside = s.or(front, back);
        if s.bits(inside) == 0 {
            return limit;
        }
        // Distance from the triangle's plane: exactly 0 if the origin touches a surface along the axes. A ray in the
        // plane gives NaN or inf, which both comparisons refuse.
        let a = s.sub3(s.load3(&block.corner[0]), self.origin);
        let b = s.sub3(s.load3(&block.corner[1]), self.origin);
        let c = s.sub3(s.load3(&block.corner[2]), self.origin);
        let normal = s.cross(s.sub3(b, a), s.sub3(c, a));
        let t = s.div(s.dot(normal, a), s.dot(normal, self.direction));
        let limits = s.splat(limit);
        let valid = s.and(inside, s.and(s.lt(zero, t), s.lt(t, limits)));
        s.reduce_min(s.select(valid, t, limits))
    }

    /// A corner of 8 triangles in the frame where the ray is the third axis.
    #[inline(always)]
    fn sheared(&self, s: S, corner: &[[f32; 8]; 3]) -> [S::F; 2] {
        let [x, y, z] = self.axes;
        let along = s.sub(s.load(&corner[z]), self.origin[z]);
        [
            s.sub(
                s.sub(s.load(&corner[x]), self.origin[x]),
                s.mul(self.shear[0], along),
            ),
            s.sub(
                s.sub(s.load(&corner[y]), self.origin[y]),
                s.mul(self.shear[1], along),
            ),
        ]
    }
}

/// The edge function of p and q at the ray. Two roundings and no fused multiply: only then is the value exactly negated
/// for the triangle on the edge's other side.
#[inline(always)]
fn edge<S: Simd>(s: S, p: [S::F; 2], q: [S::F; 2]) -> S::F {
    s.sub(s.mul(p[0], q[1]), s.mul(p[1], q[0]))
}
