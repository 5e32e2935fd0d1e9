//! Images by packets of 4 x 4 rays: one walk through the hierarchy for 16 rays that share their origin.
//!
//! Boxes and blocks of triangles are tested against the packet's frustum, 8 at a time; triangles that remain meet
//! the 16 rays at once. Edge functions are dot products of ray and Plücker coordinates, written so that both
//! triangles at an edge compute exactly negated values: no ray slips between them.
use super::bvh::{Block, Bvh, Child};
use super::ray::{push_sorted, with_stack, Entry};
use super::simd::{Kernel, Lanes, Simd};
use super::view::View;
use crate::geometry::Vec3;

/// Side of a packet in pixels.
const SIDE: usize = 4;
/// The frustum is wider than the rays by this many pixels: far more than rounding, far less than a pixel.
const MARGIN: f32 = 0.01;

/// Renders `view` into `out` (row-major).
pub struct Packets<'a> {
    pub bvh: &'a Bvh,
    pub view: &'a View<'a>,
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
        with_stack(|todo| {
            for v in (0..camera.height).step_by(SIDE) {
                let y = s.div(s.add(rows, s.splat(v as f32)), fy);
                for u in (0..camera.width).step_by(SIDE) {
                    let x = s.div(s.add(columns, s.splat(u as f32)), fx);
                    let packet = Packet::new(lanes, view, u, v, x, y);
                    let z = packet.trace(lanes, self.bvh, view.limit(s, x, y), todo);
                    let mut depth = [0.0; 16];
                    s.store(view.depth(s, z, x, y), &mut depth);
                    let wide = SIDE.min(camera.width - u);
                    for (k, row) in depth.chunks_exact(SIDE).enumerate().take(camera.height - v) {
                        let start = (v + k) * camera.width + u;
                        self.out[start..start + wide].copy_from_slice(&row[..wide]);
                    }
                }
            }
        });
    }
}

type Wide<L> = <<L as Lanes>::S16 as Simd>::F;
type Narrow<L> = <<L as Lanes>::S8 as Simd>::F;

/// Inverse ends of an interval of directions, and whether it is positive.
type Slab<L> = ([Narrow<L>; 2], bool);

struct Packet<L: Lanes> {
    origin: [Narrow<L>; 3],
    rays: [Wide<L>; 3],
    corners: [[Narrow<L>; 3]; 4],
    /// Outward normals of the four sides; the signs choose the corner of a box that lies furthest inside.
    sides: [[Narrow<L>; 3]; 4],
    positive: [[bool; 3]; 4],
    /// By axis: both inverse ends of the directions' interval and its sign; none where the interval contains 0.
    slabs: [Option<Slab<L>>; 3],
}

impl<L: Lanes> Packet<L> {
    #[inline(always)]
    fn new(lanes: L, view: &View, u: usize, v: usize, x: Wide<L>, y: Wide<L>) -> Self {
        let (s8, s16) = (lanes.s8(), lanes.s16());
        let low = |first: usize| first as f32 + 0.5 - MARGIN;
        let high = |first: usize| (first + SIDE) as f32 - 0.5 + MARGIN;
        let corners = [
            view.direction(low(u), low(v)),
            view.direction(high(u), low(v)),
            view.direction(high(u), high(v)),
            view.direction(low(u), high(v)),
        ];
        // right x down = forward: walking round the corners, the cross product points inwards.
        let sides: [Vec3; 4] = std::array::from_fn(|i| corners[(i + 1) % 4].cross(corners[i]));
        let least = corners[0].min(corners[1]).min(corners[2]).min(corners[3]);
        let most = corners[0].max(corners[1]).max(corners[2]).max(corners[3]);
        Self {
            origin: s8.splat3(view.origin.to_array()),
            rays: std::array::from_fn(|axis| {
                let down =
                    s16.mul_add(y, s16.splat(view.down[axis]), s16.splat(view.forward[axis]));
                s16.mul_add(x, s16.splat(view.right[axis]), down)
            }),
            corners: corners.map(|c| s8.splat3(c.to_array())),
            sides: sides.map(|n| s8.splat3(n.to_array())),
            positive: sides.map(|n| n.to_array().map(|x| x > 0.0)),
            slabs: std::array::from_fn(|axis| {
                let (low, high) = (least[axis], most[axis]);
                let inverse = [s8.splat(1.0 / low), s8.splat(1.0 / high)];
                (low > 1e-6 || high < -1e-6).then_some((inverse, low > 0.0))
            }),
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
                let (hits, distances) = self.enter_boxes(lanes, &node.lower, &node.upper, furthest);
                if hits == 0 {
                    break;
                }
                let nearest = push_sorted(todo, &mut top, hits, &distances, &node.children);
                if !nearest.child.is_leaf() {
                    node = &bvh.nodes[nearest.child.index as usize];
                    continue;
                }
                best = self.hit_leaf(lanes, bvh, nearest.child, best);
                furthest = s.reduce_max(best);
                break;
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
    fn enter_boxes(
        &self,
        lanes: L,
        lower: &[[f32; 8]; 3],
        upper: &[[f32; 8]; 3],
        limit: f32,
    ) -> (u32, [f32; 8]) {
        let s = lanes.s8();
        let low: [_; 3] =
            std::array::from_fn(|axis| s.sub(s.load(&lower[axis]), self.origin[axis]));
        let high: [_; 3] =
            std::array::from_fn(|axis| s.sub(s.load(&upper[axis]), self.origin[axis]));
        let mut near = s.zero();
        let mut far = s.splat(limit);
        for axis in 0..3 {
            let Some((inverse, positive)) = self.slabs[axis] else {
                continue;
            };
            let (first, second) = if positive {
                (low[axis], high[axis])
            } else {
                (high[axis], low[axis])
            };
            near = s.max(
                s.min(s.mul(first, inverse[0]), s.mul(first, inverse[1])),
                near,
            );
            far = s.min(
                s.max(s.mul(second, inverse[0]), s.mul(second, inverse[1])),
                far,
            );
        }
        let mut hits = s.le(near, s.mul(far, s.splat(1.0 + 4.0 * f32::EPSILON)));
        for (side, positive) in self.sides.iter().zip(&self.positive) {
            let innermost: [_; 3] = std::array::from_fn(|axis| {
                if positive[axis] {
                    low[axis]
                } else {
                    high[axis]
                }
            });
            hits = s.and(hits, s.le(s.dot(*side, innermost), s.zero()));
        }
        let mut distances = [0.0; 8];
        s.store(near, &mut distances);
        (s.bits(hits), distances)
    }

    #[inline(always)]
    fn hit_leaf(&self, lanes: L, bvh: &Bvh, leaf: Child, best: Wide<L>) -> Wide<L> {
        bvh.blocks[leaf.index as usize..(leaf.index + leaf.count()) as usize]
            .iter()
            .fold(best, |best, block| self.hit_block(lanes, block, best))
    }

    #[inline(always)]
    fn hit_block(&self, lanes: L, block: &Block, best: Wide<L>) -> Wide<L> {
        let s = lanes.s8();
        let corner: [[_; 3]; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|axis| s.sub(s.load(&block.corner[i][axis]), self.origin[axis]))
        });
        let sides: [[_; 3]; 3] = std::array::from_fn(|i| {
            let (p, q) = (corner[(i + 1) % 3], corner[(i + 2) % 3]);
            std::array::from_fn(|axis| s.sub(p[axis], q[axis]))
        });
        // Plücker coordinates of the side opposite each corner: (p - q) x (p + q) = 2 p x q, but precise for short sides.
        let edges: [[_; 3]; 3] = std::array::from_fn(|i| {
            let (p, q) = (corner[(i + 1) % 3], corner[(i + 2) % 3]);
            let sum = std::array::from_fn(|axis| s.add(p[axis], q[axis]));
            s.cross(sides[i], sum)
        });
        // A triangle is out if one edge has the whole frustum on its outer side, whichever way the triangle faces.
        let zero = s.zero();
        let mut front = s.le(zero, zero);
        let mut back = front;
        for edge in edges {
            let at = self.corners.map(|c| s.dot(c, edge));
            let most = s.max(s.max(at[0], at[1]), s.max(at[2], at[3]));
            let least = s.min(s.min(at[0], at[1]), s.min(at[2], at[3]));
            front = s.and(front, s.le(zero, most));
            back = s.and(back, s.le(least, zero));
        }
        let mut remaining = s.bits(s.or(front, back));
        if remaining == 0 {
            return best;
        }
        // Depth from the triangle's plane: exactly 0 if the camera touches a surface along the axes.
        let normal = s.cross(sides[1], sides[2]);
        let mut coordinates = [[[0.0f32; 8]; 3]; 4];
        for (vector, to) in edges.iter().chain([&normal]).zip(&mut coordinates) {
            for axis in 0..3 {
                s.store(vector[axis], &mut to[axis]);
            }
        }
        let mut distances = [0.0f32; 8];
        s.store(s.dot(corner[0], normal), &mut distances);
        let s = lanes.s16();
        let zero = s.zero();
        let mut best = best;
        while remaining != 0 {
            let lane = (remaining.trailing_zeros() & 7) as usize;
            remaining &= remaining - 1;
            let value = |i: usize| {
                s.dot(
                    self.rays,
                    std::array::from_fn(|axis| s.splat(coordinates[i][axis][lane])),
                )
            };
            let (u, v, w) = (value(0), value(1), value(2));
            let front = s.and(s.le(zero, u), s.and(s.le(zero, v), s.le(zero, w)));
            let back = s.and(s.le(u, zero), s.and(s.le(v, zero), s.le(w, zero)));
            let inside = s.or(front, back);
            if s.bits(inside) == 0 {
                continue;
            }
            // A ray in the plane gives z = NaN or inf, which both comparisons refuse.
            let z = s.div(s.splat(distances[lane]), value(3));
            let nearer = s.and(inside, s.and(s.lt(zero, z), s.lt(z, best)));
            best = s.select(nearer, z, best);
        }
        best
    }
}
