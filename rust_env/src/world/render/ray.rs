//! One ray against the hierarchy: 8 boxes, then 8 triangles at a time.
//!
//! The triangle test is the watertight one of Woop, Benthin and Wald (JCGT 2013): the ray becomes the z axis by a
//! shear, and the sign of each edge function is the same seen from both triangles at an edge, so that no ray slips
//! between them.
use super::bvh::{Block, Bvh, Child, STACK};
use super::simd::{Kernel, Lanes, Simd};
use crate::geometry::Vec3;
use std::cell::RefCell;

/// Slab distances are widened by this factor, so that rounding never loses a box that a ray touches
/// (Ize, "Robust BVH ray traversal", JCGT 2013).
const WIDEN: f32 = 1.0 + 4.0 * f32::EPSILON;

#[derive(Clone, Copy, Default)]
pub struct Entry {
    /// Where the ray enters the child's box.
    pub distance: f32,
    pub child: Child,
}

thread_local! {
    // Kept between casts: clearing one for each ray would cost a fifth of the cast.
    static TODO: RefCell<Vec<Entry>> = RefCell::new(vec![Entry::default(); STACK]);
}

/// Calls `f` with this thread's traversal stack of [`STACK`] entries.
#[inline(always)]
pub fn with_stack<R>(f: impl FnOnce(&mut [Entry]) -> R) -> R {
    TODO.with_borrow_mut(|todo| f(todo))
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
    let entry = |lane: usize| Entry {
        distance: distances[lane & 7],
        child: children[lane & 7],
    };
    let mut nearest = entry(hits.trailing_zeros() as usize);
    hits &= hits - 1;
    let bottom = *top;
    while hits != 0 {
        let mut e = entry(hits.trailing_zeros() as usize);
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
}

impl Kernel for Cast<'_> {
    type Output = Option<f32>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Option<f32> {
        let s = lanes.s8();
        let root = self.bvh.nodes.first()?;
        let ray = Ray::new(s, self.origin, self.direction);
        with_stack(|todo| {
            let mut limit = self.limit;
            let mut found = false;
            let mut top = 0;
            let mut node = root;
            'next: loop {
                // Down from `node` along the nearest children.
                loop {
                    let (hits, distances) = ray.enter_boxes(s, &node.lower, &node.upper, limit);
                    if hits == 0 {
                        break;
                    }
                    let nearest = push_sorted(todo, &mut top, hits, &distances, &node.children);
                    if !nearest.child.is_leaf() {
                        node = &self.bvh.nodes[nearest.child.index as usize];
                        continue;
                    }
                    if let Some(t) = ray.hit_leaf(s, self.bvh, nearest.child, limit) {
                        limit = t;
                        found = true;
                    }
                    break;
                }
                while top > 0 {
                    top -= 1;
                    let entry = todo[top];
                    if entry.distance >= limit {
                        continue;
                    }
                    if !entry.child.is_leaf() {
                        node = &self.bvh.nodes[entry.child.index as usize];
                        continue 'next;
                    }
                    if let Some(t) = ray.hit_leaf(s, self.bvh, entry.child, limit) {
                        limit = t;
                        found = true;
                    }
                }
                return found.then_some(limit);
            }
        })
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

impl<S: Simd> Ray<S> {
    #[inline(always)]
    fn new(s: S, origin: Vec3, direction: Vec3) -> Self {
        // A zero component would give 0 * inf = NaN in the slab test.
        let inverse = direction.to_array().map(|d| {
            1.0 / if d.abs() < 1e-20 {
                1e-20f32.copysign(d)
            } else {
                d
            }
        });
        let size = direction.abs();
        let z = if size.x > size.y && size.x > size.z {
            0
        } else if size.y > size.z {
            1
        } else {
            2
        };
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let along = direction[z];
        Self {
            origin: s.splat3(origin.to_array()),
            direction: s.splat3(direction.to_array()),
            inverse: s.splat3(inverse),
            negative: inverse.map(|i| i < 0.0),
            axes: [x, y, z],
            shear: [s.splat(direction[x] / along), s.splat(direction[y] / along)],
        }
    }

    /// Which of 8 boxes the ray enters before `limit`, and where.
    #[inline(always)]
    fn enter_boxes(
        &self,
        s: S,
        lower: &[[f32; 8]; 3],
        upper: &[[f32; 8]; 3],
        limit: f32,
    ) -> (u32, [f32; 8]) {
        let mut near = s.zero();
        let mut far = s.splat(limit);
        for axis in 0..3 {
            let (first, second) = if self.negative[axis] {
                (&upper[axis], &lower[axis])
            } else {
                (&lower[axis], &upper[axis])
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

    #[inline(always)]
    fn hit_leaf(&self, s: S, bvh: &Bvh, leaf: Child, limit: f32) -> Option<f32> {
        let mut best = None;
        let mut limit = limit;
        for block in &bvh.blocks[leaf.index as usize..(leaf.index + leaf.count()) as usize] {
            if let Some(t) = self.hit_block(s, block, limit) {
                limit = t;
                best = Some(t);
            }
        }
        best
    }

    #[inline(always)]
    fn hit_block(&self, s: S, block: &Block, limit: f32) -> Option<f32> {
        let [kx, ky, kz] = self.axes;
        let corner = |i: usize| {
            let relative = |axis: usize| s.sub(s.load(&block.corner[i][axis]), self.origin[axis]);
            let (x, y, z) = (relative(kx), relative(ky), relative(kz));
            [
                s.sub(x, s.mul(self.shear[0], z)),
                s.sub(y, s.mul(self.shear[1], z)),
            ]
        };
        let (a, b, c) = (corner(0), corner(1), corner(2));
        // Two roundings and no fused multiply: only then is an edge's value exactly negated for its other triangle.
        let edge = |p: [S::F; 2], q: [S::F; 2]| s.sub(s.mul(p[0], q[1]), s.mul(p[1], q[0]));
        let (u, v, w) = (edge(c, b), edge(a, c), edge(b, a));
        let zero = s.zero();
        let inside = |low: S::F, high: S::F| s.le(low, high);
        let all = |m: [S::M; 3]| s.and(m[0], s.and(m[1], m[2]));
        let front = all([inside(zero, u), inside(zero, v), inside(zero, w)]);
        let back = all([inside(u, zero), inside(v, zero), inside(w, zero)]);
        let either = s.or(front, back);
        if s.bits(either) == 0 {
            return None;
        }
        // Distance from the triangle's plane: exactly 0 if the origin touches a surface along the axes. A ray in the
        // plane gives NaN or inf, which both comparisons refuse.
        let corner = |i: usize| -> [S::F; 3] {
            std::array::from_fn(|axis| s.sub(s.load(&block.corner[i][axis]), self.origin[axis]))
        };
        let (a, b, c) = (corner(0), corner(1), corner(2));
        let normal = s.cross(
            std::array::from_fn(|axis| s.sub(b[axis], a[axis])),
            std::array::from_fn(|axis| s.sub(c[axis], a[axis])),
        );
        let t = s.div(s.dot(normal, a), s.dot(normal, self.direction));
        let valid = s.and(either, s.and(s.lt(zero, t), s.lt(t, s.splat(limit))));
        (s.bits(valid) != 0).then(|| s.reduce_min(s.select(valid, t, s.splat(f32::INFINITY))))
    }
}
