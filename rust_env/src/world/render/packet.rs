//! Images by packets of 4 x 4 rays: one walk through the hierarchy for 16 rays that share their origin.
//!
//! Boxes and blocks of triangles are tested against the packet's frustum, 8 at a time; triangles that remain meet
//! the 16 rays at once. Edge functions are dot products of ray and Plücker coordinates, written so that both
//! triangles at an edge compute exactly negated values: no ray slips between them.
use super::bvh::{Block, Bvh, Child, Node};
use super::ray::{push_sorted, Entry, WIDEN};
use super::simd::{Kernel, Lanes, Simd};
use super::view::View;
use crate::camera::Camera;
use crate::geometry::Vec3;

/// Side of a packet in pixels.
const SIDE: usize = 4;
/// The frustum is wider than the rays by this many pixels: far more than rounding, far less than a pixel.
const MARGIN: f32 = 0.01;

/// A rectangle of pixels; right and bottom are beyond its last.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    pub left: usize,
    pub right: usize,
    pub top: usize,
    pub bottom: usize,
}

impl Window {
    /// The whole image.
    pub fn of(camera: &Camera) -> Self {
        Self {
            left: 0,
            right: camera.width,
            top: 0,
            bottom: camera.height,
        }
    }
}

/// Renders a window of `view` into `out` (row-major).
pub struct Packets<'a> {
    pub bvh: &'a Bvh,
    pub view: &'a View<'a>,
    pub todo: &'a mut [Entry],
    pub window: Window,
    /// Over what `out` holds: the nearer depth stays.
    pub over: bool,
    pub out: &'a mut [f32],
}

impl Kernel for Packets<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let s = lanes.s16();
        let (view, camera) = (self.view, self.view.camera);
        let mut columns = [0.0; 16];
        let mut rows = [0.0; 16];
        for lane in 0..16 {
            columns[lane] = (lane % SIDE) as f32 + 0.5 - camera.cx;
            rows[lane] = (lane / SIDE) as f32 + 0.5 - camera.cy;
        }
        let (columns, rows) = (s.load(&columns), s.load(&rows));
        let (fx, fy) = (s.splat(camera.fx), s.splat(camera.fy));
        let Window {
            left,
            right,
            top,
            bottom,
        } = self.window;
        for v in (top..bottom).step_by(SIDE) {
            let y = s.div(s.add(rows, s.splat(v as f32)), fy);
            for u in (left..right).step_by(SIDE) {
                let x = s.div(s.add(columns, s.splat(u as f32)), fx);
                let packet = Packet::new(lanes, view, u, v, x, y);
                let z = packet.trace(lanes, self.bvh, view.limit(s, x, y), self.todo);
                let mut depth = [0.0; 16];
                s.store(view.depth(s, z, x, y), &mut depth);
                let wide = SIDE.min(right - u);
                for row in 0..SIDE.min(bottom - v) {
                    let start = (v + row) * camera.width + u;
                    let pixels = &mut self.out[start..start + wide];
                    let depth = &depth[row * SIDE..row * SIDE + wide];
                    if self.over {
                        for (pixel, depth) in pixels.iter_mut().zip(depth) {
                            *pixel = pixel.min(*depth);
                        }
                    } else {
                        pixels.copy_from_slice(depth);
                    }
                }
            }
        }
    }
}

type Wide<L> = <<L as Lanes>::S16 as Simd>::F;
type Narrow<L> = <<L as Lanes>::S8 as Simd>::F;

struct Packet<L: Lanes> {
    origin: [Narrow<L>; 3],
    rays: [Wide<L>; 3],
    corners: [[Narrow<L>; 3]; 4],
    /// Outward normals of the four sides.
    sides: [[Narrow<L>; 3]; 4],
    /// Signs of the normals: they choose the corner of a box that lies furthest inside.
    positive: [[bool; 3]; 4],
    slabs: [Slab<L>; 3],
}

/// The interval of the directions along one axis.
struct Slab<L: Lanes> {
    /// False if the interval contains 0.
    known: bool,
    positive: bool,
    /// Inverse ends.
    inverse: [Narrow<L>; 2],
}

impl<L: Lanes> Slab<L> {
    #[inline(always)]
    fn new(s: L::S8, least: f32, most: f32) -> Self {
        Self {
            known: least > 1e-6 || most < -1e-6,
            positive: least > 0.0,
            inverse: [s.splat(1.0 / least), s.splat(1.0 / most)],
        }
    }
}

#[inline(always)]
fn signs(v: Vec3) -> [bool; 3] {
    [v.x > 0.0, v.y > 0.0, v.z > 0.0]
}

/// One coordinate of the rays forward + x right + y down.
#[inline(always)]
fn ray<S: Simd>(s: S, forward: f32, right: f32, down: f32, x: S::F, y: S::F) -> S::F {
    s.mul_add(
        x,
        s.splat(right),
        s.mul_add(y, s.splat(down), s.splat(forward)),
    )
}

impl<L: Lanes> Packet<L> {
    #[inline(always)]
    fn new(lanes: L, view: &View, u: usize, v: usize, x: Wide<L>, y: Wide<L>) -> Self {
        let (s, wide) = (lanes.s8(), lanes.s16());
        let (left, top) = (u as f32 + 0.5 - MARGIN, v as f32 + 0.5 - MARGIN);
        let (right, bottom) = (
            (u + SIDE) as f32 - 0.5 + MARGIN,
            (v + SIDE) as f32 - 0.5 + MARGIN,
        );
        let a = view.direction(left, top);
        let b = view.direction(right, top);
        let c = view.direction(right, bottom);
        let d = view.direction(left, bottom);
        // right x down = forward: walking round the corners, this order gives normals that point outwards.
        let sides = [b.cross(a), c.cross(b), d.cross(c), a.cross(d)];
        let least = a.min(b).min(c).min(d);
        let most = a.max(b).max(c).max(d);
        let rays = [
            ray(wide, view.forward.x, view.right.x, view.down.x, x, y),
            ray(wide, view.forward.y, view.right.y, view.down.y, x, y),
            ray(wide, view.forward.z, view.right.z, view.down.z, x, y),
        ];
        Self {
            origin: s.splat3(view.origin.to_array()),
            rays,
            corners: [
                s.splat3(a.to_array()),
                s.splat3(b.to_array()),
                s.splat3(c.to_array()),
                s.splat3(d.to_array()),
            ],
            sides: [
                s.splat3(sides[0].to_array()),
                s.splat3(sides[1].to_array()),
                s.splat3(sides[2].to_array()),
                s.splat3(sides[3].to_array()),
            ],
            positive: [
                signs(sides[0]),
                signs(sides[1]),
                signs(sides[2]),
                signs(sides[3]),
            ],
            slabs: [
                Slab::new(s, least.x, most.x),
                Slab::new(s, least.y, most.y),
                Slab::new(s, least.z, most.z),
            ],
        }
    }

    /// z-depth of the nearest hit of each ray before `limit`, else `limit`.
    #[inline(always)]
    fn trace(&self, lanes: L, bvh: &Bvh, limit: Wide<L>, todo: &mut [Entry]) -> Wide<L> {
        let s = lanes.s16();
        let mut best = limit;
        let Some(mut node) = bvh.nodes.first() else {
            return best;
        };
        let mut furthest = s.reduce_max(best);
        let mut top = 0;
        'next: loop {
            loop {
                let (hits, distances) = self.enter_boxes(lanes, node, furthest);
                if hits == 0 {
                    break;
                }
                let nearest = push_sorted(todo, &mut top, hits, &distances, &node.children);
                if nearest.child.is_leaf() {
                    best = self.hit_leaf(lanes, bvh, nearest.child, best);
                    furthest = s.reduce_max(best);
                    break;
                }
                node = &bvh.nodes[nearest.child.index as usize];
            }
            while top > 0 {
                top -= 1;
                let entry = todo[top];
                if entry.distance >= furthest {
                    continue;
                }
                if !entry.child.is_leaf() {
                    node = &bvh.nodes[entry.child.index as usize];
                    continue 'next;
                }
                best = self.hit_leaf(lanes, bvh, entry.child, best);
                furthest = s.reduce_max(best);
            }
            return best;
        }
    }

    /// Which of 8 boxes the frustum may touch before z-depth `limit`, and a lower bound of where.
    #[inline(always)]
    fn enter_boxes(&self, lanes: L, node: &Node, limit: f32) -> (u32, [f32; 8]) {
        let s = lanes.s8();
        let low = s.sub3(s.load3(&node.lower), self.origin);
        let high = s.sub3(s.load3(&node.upper), self.origin);
        let mut near = s.zero();
        let mut far = s.splat(limit);
        for axis in 0..3 {
            let slab = &self.slabs[axis];
            if !slab.known {
                continue;
            }
            let (first, second) = if slab.positive {
                (low[axis], high[axis])
            } else {
                (high[axis], low[axis])
            };
            let enter = s.min(s.mul(first, slab.inverse[0]), s.mul(first, slab.inverse[1]));
            let leave = s.max(
                s.mul(second, slab.inverse[0]),
                s.mul(second, slab.inverse[1]),
            );
            near = s.max(enter, near);
            far = s.min(leave, far);
        }
        let mut hits = s.le(near, s.mul(far, s.splat(WIDEN)));
        for side in 0..4 {
            let positive = &self.positive[side];
            let innermost = [
                if positive[0] { low[0] } else { high[0] },
                if positive[1] { low[1] } else { high[1] },
                if positive[2] { low[2] } else { high[2] },
            ];
            hits = s.and(hits, s.le(s.dot(self.sides[side], innermost), s.zero()));
        }
        let mut distances = [0.0; 8];
        s.store(near, &mut distances);
        (s.bits(hits), distances)
    }

    #[inline(always)]
    fn hit_leaf(&self, lanes: L, bvh: &Bvh, leaf: Child, best: Wide<L>) -> Wide<L> {
        let mut best = best;
        for block in &bvh.blocks[leaf.index as usize..(leaf.index + leaf.count()) as usize] {
            best = self.hit_block(lanes, block, best);
        }
        best
    }

    /// Least and most of a dot product with the frustum's corners.
    #[inline(always)]
    fn range(&self, s: L::S8, edge: [Narrow<L>; 3]) -> (Narrow<L>, Narrow<L>) {
        let a = s.dot(self.corners[0], edge);
        let b = s.dot(self.corners[1], edge);
        let c = s.dot(self.corners[2], edge);
        let d = s.dot(self.corners[3], edge);
        (
            s.min(s.min(a, b), s.min(c, d)),
            s.max(s.max(a, b), s.max(c, d)),
        )
    }

    #[inline(always)]
    fn hit_block(&self, lanes: L, block: &Block, best: Wide<L>) -> Wide<L> {
        let s = lanes.s8();
        let a = s.sub3(s.load3(&block.corner[0]), self.origin);
        let b = s.sub3(s.load3(&block.corner[1]), self.origin);
        let c = s.sub3(s.load3(&block.corner[2]), self.origin);
        let (bc, ca, ab) = (s.sub3(b, c), s.sub3(c, a), s.sub3(a, b));
        // Plücker coordinates of the side opposite each corner: (p - q) x (p + q) = 2 p x q, but precise for short sides.
        let u = s.cross(bc, s.add3(b, c));
        let v = s.cross(ca, s.add3(c, a));
        let w = s.cross(ab, s.add3(a, b));
        // A triangle is out if one edge has the whole frustum on its outer side, whichever way the triangle faces.
        let zero = s.zero();
        let (u_least, u_most) = self.range(s, u);
        let (v_least, v_most) = self.range(s, v);
        let (w_least, w_most) = self.range(s, w);
        let front = s.and(
            s.le(zero, u_most),
            s.and(s.le(zero, v_most), s.le(zero, w_most)),
        );
        let back = s.and(
            s.le(u_least, zero),
            s.and(s.le(v_least, zero), s.le(w_least, zero)),
        );
        let mut remaining = s.bits(s.or(front, back));
        if remaining == 0 {
            return best;
        }
        // Depth from the triangle's plane: exactly 0 if the camera touches a surface along the axes.
        let normal = s.cross(ca, ab);
        let mut coordinates = [[[0.0f32; 8]; 3]; 4];
        s.store3(u, &mut coordinates[0]);
        s.store3(v, &mut coordinates[1]);
        s.store3(w, &mut coordinates[2]);
        s.store3(normal, &mut coordinates[3]);
        let mut distances = [0.0f32; 8];
        s.store(s.dot(a, normal), &mut distances);
        let s = lanes.s16();
        let zero = s.zero();
        let mut best = best;
        while remaining != 0 {
            let lane = (remaining.trailing_zeros() & 7) as usize;
            remaining &= remaining - 1;
            let u = self.along(s, &coordinates[0], lane);
            let v = self.along(s, &coordinates[1], lane);
            let w = self.along(s, &coordinates[2], lane);
            let front = s.and(s.le(zero, u), s.and(s.le(zero, v), s.le(zero, w)));
            let back = s.and(s.le(u, zero), s.and(s.le(v, zero), s.le(w, zero)));
            let inside = s.or(front, back);
            if s.bits(inside) == 0 {
                continue;
            }
            // A ray in the plane gives z = NaN or inf, which both comparisons refuse.
            let z = s.div(
                s.splat(distances[lane]),
                self.along(s, &coordinates[3], lane),
            );
            let nearer = s.and(inside, s.and(s.lt(zero, z), s.lt(z, best)));
            best = s.select(nearer, z, best);
        }
        best
    }

    /// Dot products of the rays with one of 8 vectors.
    #[inline(always)]
    fn along(&self, s: L::S16, vectors: &[[f32; 8]; 3], lane: usize) -> Wide<L> {
        s.dot(self.rays, s.splat3_of(vectors, lane))
    }
}
