//! Images by rasterisation: triangles from near to far into a buffer of 1/z, subtrees behind it are skipped.
//!
//! Edge functions and depth are homogeneous (Olano and Greer 1997): linear over the image for every triangle, also one
//! that reaches behind the camera, so that nothing is clipped. As in [`super::packet`], both triangles at an edge compute
//! exactly negated values. The buffer keeps the farthest depth of each tile of 16 x 16 pixels (Greene 1993).
use super::bvh::{Block, Bvh, Child, Node};
use super::simd::{Kernel, Lanes, Simd};
use super::view::View;
use crate::geometry::Vec3;

/// Pixels are kept in blocks of 4 x 4, blocks in tiles of 4 x 4.
const SIDE: usize = 4;
const TILE: usize = 16;
/// Subtrees of at most this many blocks of triangles are drawn whole.
const CLUSTER: u32 = 12;
/// Where a triangle or box that reaches behind the camera is cut to find its pixels, metres of z-depth.
const CUT: f32 = 1e-5;
/// Pixel rectangles are grown by this, in pixels: far more than rounding.
const MARGIN: f32 = 0.01;

/// What stays allocated between images.
#[derive(Default)]
pub struct Scratch {
    /// 1/z by block, row-major in each.
    inverse: Vec<f32>,
    /// Least 1/z of each tile, and whether it must be computed again.
    farthest: Vec<f32>,
    stale: Vec<bool>,
    todo: Vec<Entry>,
}

/// A rectangle of tiles, both ends included.
#[derive(Clone, Copy, Default)]
struct Rect {
    left: u16,
    right: u16,
    top: u16,
    bottom: u16,
}

#[derive(Clone, Copy)]
struct Entry {
    nearest: f32,
    child: Child,
    tiles: Rect,
}

/// Renders `view` into `out` (row-major).
pub struct Raster<'a> {
    pub bvh: &'a Bvh,
    pub view: &'a View<'a>,
    pub scratch: &'a mut Scratch,
    pub out: &'a mut [f32],
}

impl Kernel for Raster<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let camera = self.view.camera;
        let mut canvas = Canvas::<L>::new(lanes, self.view, self.scratch);
        canvas.draw(lanes, self.bvh);
        canvas.resolve(lanes, self.view, self.out, camera.width, camera.height);
    }
}

type Wide<L> = <<L as Lanes>::S16 as Simd>::F;
type Narrow<L> = <<L as Lanes>::S8 as Simd>::F;

/// The image plane and the camera's axes.
struct Canvas<'a, L: Lanes> {
    inverse: &'a mut [f32],
    farthest: &'a mut [f32],
    stale: &'a mut [bool],
    todo: &'a mut Vec<Entry>,
    blocks_wide: usize,
    blocks_high: usize,
    tiles_wide: usize,
    width: f32,
    height: f32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    /// Geometry beyond this z-depth is out of range.
    limit: f32,
    origin: [Narrow<L>; 3],
    right: [Narrow<L>; 3],
    down: [Narrow<L>; 3],
    forward: [Narrow<L>; 3],
    /// Inward normals of the frustum's sides, and their signs.
    sides: [[Narrow<L>; 3]; 4],
    positive: [[bool; 3]; 4],
    ahead: [bool; 3],
    /// Pixel centres of a block's lanes.
    columns: Wide<L>,
    rows: Wide<L>,
}

/// Linear functions over the image for 8 triangles: three edges and 1/z, each as slopes and value at the principal point.
struct Setup {
    edge: [[[f32; 8]; 3]; 3],
    inverse: [[f32; 8]; 3],
    /// Range of 1/z over the corners.
    least: [f32; 8],
    most: [f32; 8],
    /// Pixels: left, right, top, bottom.
    bounds: [[f32; 8]; 4],
}

#[inline(always)]
fn signs(v: Vec3) -> [bool; 3] {
    [v.x > 0.0, v.y > 0.0, v.z > 0.0]
}

#[inline(always)]
fn pick<T: Copy>(positive: &[bool; 3], when: &[T; 3], otherwise: &[T; 3]) -> [T; 3] {
    [
        if positive[0] { when[0] } else { otherwise[0] },
        if positive[1] { when[1] } else { otherwise[1] },
        if positive[2] { when[2] } else { otherwise[2] },
    ]
}

impl<'a, L: Lanes> Canvas<'a, L> {
    #[inline(always)]
    fn new(lanes: L, view: &View, scratch: &'a mut Scratch) -> Self {
        let (s, wide) = (lanes.s8(), lanes.s16());
        let camera = view.camera;
        let (blocks_wide, blocks_high) =
            (camera.width.div_ceil(SIDE), camera.height.div_ceil(SIDE));
        let (tiles_wide, tiles_high) = (camera.width.div_ceil(TILE), camera.height.div_ceil(TILE));
        let limit = camera.far * (1.0 + 1e-5);
        scratch.inverse.clear();
        scratch
            .inverse
            .resize(blocks_wide * blocks_high * SIDE * SIDE, 1.0 / limit);
        scratch.farthest.clear();
        scratch
            .farthest
            .resize(tiles_wide * tiles_high, 1.0 / limit);
        scratch.stale.clear();
        scratch.stale.resize(tiles_wide * tiles_high, false);
        scratch.todo.clear();
        let (w, h) = (camera.width as f32, camera.height as f32);
        let (a, b) = (
            view.direction(-MARGIN, -MARGIN),
            view.direction(w + MARGIN, -MARGIN),
        );
        let (c, d) = (
            view.direction(w + MARGIN, h + MARGIN),
            view.direction(-MARGIN, h + MARGIN),
        );
        let sides = [a.cross(b), b.cross(c), c.cross(d), d.cross(a)];
        let mut columns = [0.0; 16];
        let mut rows = [0.0; 16];
        for lane in 0..16 {
            columns[lane] = (lane % SIDE) as f32 + 0.5;
            rows[lane] = (lane / SIDE) as f32 + 0.5;
        }
        Self {
            inverse: &mut scratch.inverse,
            farthest: &mut scratch.farthest,
            stale: &mut scratch.stale,
            todo: &mut scratch.todo,
            blocks_wide,
            blocks_high,
            tiles_wide,
            width: w,
            height: h,
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            limit,
            origin: s.splat3(view.origin.to_array()),
            right: s.splat3(view.right.to_array()),
            down: s.splat3(view.down.to_array()),
            forward: s.splat3(view.forward.to_array()),
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
            ahead: signs(view.forward),
            columns: wide.load(&columns),
            rows: wide.load(&rows),
        }
    }

    #[inline(always)]
    fn draw(&mut self, lanes: L, bvh: &Bvh) {
        let Some(root) = bvh.nodes.first() else {
            return;
        };
        self.visit(lanes, root);
        while let Some(entry) = self.todo.pop() {
            // The buffer has filled since this was put aside.
            if self.is_hidden(lanes, entry.nearest, entry.tiles) {
                continue;
            }
            let child = entry.child;
            let first = if child.is_leaf() {
                child.index
            } else if child.count() <= CLUSTER {
                bvh.first_block[child.index as usize]
            } else {
                self.visit(lanes, &bvh.nodes[child.index as usize]);
                continue;
            };
            for block in &bvh.blocks[first as usize..(first + child.count()) as usize] {
                self.draw_block(lanes, block);
            }
        }
    }

    /// Puts the children of a node that can be seen on the stack, the nearest on top.
    #[inline(always)]
    fn visit(&mut self, lanes: L, node: &Node) {
        let s = lanes.s8();
        let low = s.sub3(s.load3(&node.lower), self.origin);
        let high = s.sub3(s.load3(&node.upper), self.origin);
        let nearest = s.dot(self.forward, pick(&self.ahead, &low, &high));
        let farthest = s.dot(self.forward, pick(&self.ahead, &high, &low));
        let zero = s.zero();
        let mut seen = s.and(s.lt(zero, farthest), s.lt(nearest, s.splat(self.limit)));
        for side in 0..4 {
            let innermost = pick(&self.positive[side], &high, &low);
            seen = s.and(seen, s.le(zero, s.dot(self.sides[side], innermost)));
        }
        let mut seen = s.bits(seen);
        if seen == 0 {
            return;
        }
        // Pixel rectangles of the 8 corners of 8 boxes.
        let infinity = s.splat(f32::INFINITY);
        let minus = s.splat(f32::NEG_INFINITY);
        let (mut left, mut right, mut top, mut bottom) = (infinity, minus, infinity, minus);
        for k in 0..8 {
            let corner = [
                if k & 1 == 0 { low[0] } else { high[0] },
                if k & 2 == 0 { low[1] } else { high[1] },
                if k & 4 == 0 { low[2] } else { high[2] },
            ];
            let inverse = s.div(s.splat(1.0), s.dot(self.forward, corner));
            let x = s.mul(s.dot(self.right, corner), inverse);
            let y = s.mul(s.dot(self.down, corner), inverse);
            left = s.min(x, left);
            right = s.max(x, right);
            top = s.min(y, top);
            bottom = s.max(y, bottom);
        }
        let mut rectangle = [[0.0f32; 8]; 4];
        let tile = s.splat(1.0 / TILE as f32);
        let x_scale = s.mul(s.splat(self.fx), tile);
        let y_scale = s.mul(s.splat(self.fy), tile);
        let (x_low, x_high) = (
            s.splat((self.cx - MARGIN) / TILE as f32),
            s.splat((self.cx + MARGIN) / TILE as f32),
        );
        let (y_low, y_high) = (
            s.splat((self.cy - MARGIN) / TILE as f32),
            s.splat((self.cy + MARGIN) / TILE as f32),
        );
        s.store(s.mul_add(left, x_scale, x_low), &mut rectangle[0]);
        s.store(s.mul_add(right, x_scale, x_high), &mut rectangle[1]);
        s.store(s.mul_add(top, y_scale, y_low), &mut rectangle[2]);
        s.store(s.mul_add(bottom, y_scale, y_high), &mut rectangle[3]);
        let mut depths = [0.0; 8];
        s.store(nearest, &mut depths);
        let (last_x, last_y) = (
            (self.width - 1.0) / TILE as f32,
            (self.height - 1.0) / TILE as f32,
        );
        let bottom_of_stack = self.todo.len();
        while seen != 0 {
            let lane = (seen.trailing_zeros() & 7) as usize;
            seen &= seen - 1;
            let nearest = depths[lane];
            // A box that reaches behind the camera may cover anything.
            let tiles = if nearest > CUT {
                Rect {
                    left: rectangle[0][lane].clamp(0.0, last_x) as u16,
                    right: rectangle[1][lane].clamp(0.0, last_x) as u16,
                    top: rectangle[2][lane].clamp(0.0, last_y) as u16,
                    bottom: rectangle[3][lane].clamp(0.0, last_y) as u16,
                }
            } else {
                Rect {
                    left: 0,
                    right: last_x as u16,
                    top: 0,
                    bottom: last_y as u16,
                }
            };
            if self.is_hidden(lanes, nearest, tiles) {
                continue;
            }
            let entry = Entry {
                nearest,
                child: node.children[lane],
                tiles,
            };
            let mut at = self.todo.len();
            self.todo.push(entry);
            while at > bottom_of_stack && self.todo[at - 1].nearest < nearest {
                self.todo[at] = self.todo[at - 1];
                at -= 1;
            }
            self.todo[at] = entry;
        }
    }

    /// Whether everything in these tiles is nearer than `nearest`.
    #[inline(always)]
    fn is_hidden(&mut self, lanes: L, nearest: f32, tiles: Rect) -> bool {
        if nearest <= CUT {
            return false;
        }
        // A little nearer, against rounding.
        let inverse = (1.0 + 1e-5) / nearest;
        for y in tiles.top as usize..=tiles.bottom as usize {
            for x in tiles.left as usize..=tiles.right as usize {
                let tile = y * self.tiles_wide + x;
                if self.stale[tile] {
                    self.refresh(lanes, x, y);
                }
                if self.farthest[tile] < inverse {
                    return false;
                }
            }
        }
        true
    }

    #[inline(always)]
    fn refresh(&mut self, lanes: L, x: usize, y: usize) {
        let s = lanes.s16();
        let mut least = s.splat(f32::INFINITY);
        for by in y * SIDE..(y * SIDE + SIDE).min(self.blocks_high) {
            for bx in x * SIDE..(x * SIDE + SIDE).min(self.blocks_wide) {
                let start = (by * self.blocks_wide + bx) * SIDE * SIDE;
                least = s.min(s.load(&self.inverse[start..start + SIDE * SIDE]), least);
            }
        }
        let tile = y * self.tiles_wide + x;
        self.farthest[tile] = s.reduce_min(least);
        self.stale[tile] = false;
    }

    /// 8 vectors in the camera's frame.
    #[inline(always)]
    fn in_camera(&self, s: L::S8, v: [Narrow<L>; 3]) -> [Narrow<L>; 3] {
        [
            s.dot(self.right, v),
            s.dot(self.down, v),
            s.dot(self.forward, v),
        ]
    }

    #[inline(always)]
    fn draw_block(&mut self, lanes: L, block: &Block) {
        let s = lanes.s8();
        let world = [
            s.sub3(s.load3(&block.corner[0]), self.origin),
            s.sub3(s.load3(&block.corner[1]), self.origin),
            s.sub3(s.load3(&block.corner[2]), self.origin),
        ];
        let a = self.in_camera(s, world[0]);
        let b = self.in_camera(s, world[1]);
        let c = self.in_camera(s, world[2]);
        let zero = s.zero();
        let one = s.splat(1.0);
        let nearest = s.min(s.min(a[2], b[2]), c[2]);
        let farthest = s.max(s.max(a[2], b[2]), c[2]);
        let in_range = s.and(s.lt(zero, farthest), s.lt(nearest, s.splat(self.limit)));
        let whole = s.lt(s.splat(CUT), nearest);
        // Pixel bounds, right where the whole triangle is ahead of the camera.
        let (ia, ib, ic) = (s.div(one, a[2]), s.div(one, b[2]), s.div(one, c[2]));
        let (xa, xb, xc) = (s.mul(a[0], ia), s.mul(b[0], ib), s.mul(c[0], ic));
        let (ya, yb, yc) = (s.mul(a[1], ia), s.mul(b[1], ib), s.mul(c[1], ic));
        let (fx, fy) = (s.splat(self.fx), s.splat(self.fy));
        let (low, high) = (0.5 + MARGIN, 0.5 - MARGIN);
        let left = s.ceil(s.mul_add(s.min(s.min(xa, xb), xc), fx, s.splat(self.cx - low)));
        let right = s.floor(s.mul_add(s.max(s.max(xa, xb), xc), fx, s.splat(self.cx - high)));
        let top = s.ceil(s.mul_add(s.min(s.min(ya, yb), yc), fy, s.splat(self.cy - low)));
        let bottom = s.floor(s.mul_add(s.max(s.max(ya, yb), yc), fy, s.splat(self.cy - high)));
        let left = s.max(left, zero);
        let right = s.min(right, s.splat(self.width - 1.0));
        let top = s.max(top, zero);
        let bottom = s.min(bottom, s.splat(self.height - 1.0));
        let on_pixels = s.and(s.le(left, right), s.le(top, bottom));
        let mut drawn = s.bits(s.and(in_range, s.and(whole, on_pixels)));
        let mut cut = s.bits(in_range) & !s.bits(whole);
        if drawn | cut == 0 {
            return;
        }
        let (bc, ca, ab) = (s.sub3(b, c), s.sub3(c, a), s.sub3(a, b));
        // Before the turn into the camera's frame: exactly 0 if the camera touches a surface along the axes.
        let normal = s.cross(s.sub3(world[2], world[0]), s.sub3(world[0], world[1]));
        let distance = s.dot(world[0], normal);
        let normal = self.in_camera(s, normal);
        // Seen from its back a triangle's edge functions change their signs. A triangle seen edge-on (distance 0) gets
        // 1/z = NaN or inf, which no pixel takes.
        let sign = s.select(s.lt(distance, zero), s.splat(-1.0), one);
        let u = s.cross(bc, s.add3(b, c));
        let v = s.cross(ca, s.add3(c, a));
        let w = s.cross(ab, s.add3(a, b));
        let (rx, ry) = (s.splat(1.0 / self.fx), s.splat(1.0 / self.fy));
        let mut setup = Setup {
            edge: [[[0.0; 8]; 3]; 3],
            inverse: [[0.0; 8]; 3],
            least: [0.0; 8],
            most: [0.0; 8],
            bounds: [[0.0; 8]; 4],
        };
        let (sx, sy) = (s.mul(sign, rx), s.mul(sign, ry));
        s.store3(
            [s.mul(u[0], sx), s.mul(u[1], sy), s.mul(u[2], sign)],
            &mut setup.edge[0],
        );
        s.store3(
            [s.mul(v[0], sx), s.mul(v[1], sy), s.mul(v[2], sign)],
            &mut setup.edge[1],
        );
        s.store3(
            [s.mul(w[0], sx), s.mul(w[1], sy), s.mul(w[2], sign)],
            &mut setup.edge[2],
        );
        let scale = s.div(one, distance);
        let inverse = [
            s.mul(s.mul(normal[0], scale), rx),
            s.mul(s.mul(normal[1], scale), ry),
            s.mul(normal[2], scale),
        ];
        s.store3(inverse, &mut setup.inverse);
        // The hit of a sliver with a poor normal must stay within its corners.
        s.store(
            s.select(whole, s.min(s.min(ia, ib), ic), zero),
            &mut setup.least,
        );
        s.store(
            s.select(whole, s.max(s.max(ia, ib), ic), s.splat(f32::INFINITY)),
            &mut setup.most,
        );
        s.store(left, &mut setup.bounds[0]);
        s.store(right, &mut setup.bounds[1]);
        s.store(top, &mut setup.bounds[2]);
        s.store(bottom, &mut setup.bounds[3]);
        while drawn != 0 {
            let lane = (drawn.trailing_zeros() & 7) as usize;
            drawn &= drawn - 1;
            let bounds = [
                setup.bounds[0][lane] as usize,
                setup.bounds[1][lane] as usize,
                setup.bounds[2][lane] as usize,
                setup.bounds[3][lane] as usize,
            ];
            self.fill(lanes, &setup, lane, bounds);
        }
        if cut != 0 {
            let mut corners = [[[0.0f32; 8]; 3]; 3];
            s.store3(a, &mut corners[0]);
            s.store3(b, &mut corners[1]);
            s.store3(c, &mut corners[2]);
            while cut != 0 {
                let lane = (cut.trailing_zeros() & 7) as usize;
                cut &= cut - 1;
                let triangle = [
                    Vec3::new(
                        corners[0][0][lane],
                        corners[0][1][lane],
                        corners[0][2][lane],
                    ),
                    Vec3::new(
                        corners[1][0][lane],
                        corners[1][1][lane],
                        corners[1][2][lane],
                    ),
                    Vec3::new(
                        corners[2][0][lane],
                        corners[2][1][lane],
                        corners[2][2][lane],
                    ),
                ];
                if let Some(bounds) = bounds_ahead(
                    triangle,
                    [self.fx, self.fy, self.cx, self.cy],
                    self.width,
                    self.height,
                ) {
                    self.fill(lanes, &setup, lane, bounds);
                }
            }
        }
    }

    /// Draws one triangle within pixel bounds.
    #[inline(always)]
    fn fill(&mut self, lanes: L, setup: &Setup, lane: usize, bounds: [usize; 4]) {
        let s = lanes.s16();
        let u = s.splat3_of(&setup.edge[0], lane);
        let v = s.splat3_of(&setup.edge[1], lane);
        let w = s.splat3_of(&setup.edge[2], lane);
        let inverse = s.splat3_of(&setup.inverse, lane);
        let (least, most) = (s.splat(setup.least[lane]), s.splat(setup.most[lane]));
        let zero = s.zero();
        let [left, right, top, bottom] = bounds;
        for by in top / SIDE..=bottom / SIDE {
            let y = s.add(self.rows, s.splat((by * SIDE) as f32 - self.cy));
            let (uy, vy, wy) = (
                s.mul_add(u[1], y, u[2]),
                s.mul_add(v[1], y, v[2]),
                s.mul_add(w[1], y, w[2]),
            );
            let iy = s.mul_add(inverse[1], y, inverse[2]);
            for bx in left / SIDE..=right / SIDE {
                let x = s.add(self.columns, s.splat((bx * SIDE) as f32 - self.cx));
                let edges = s.min(
                    s.mul_add(u[0], x, uy),
                    s.min(s.mul_add(v[0], x, vy), s.mul_add(w[0], x, wy)),
                );
                let inside = s.le(zero, edges);
                if s.bits(inside) == 0 {
                    continue;
                }
                let depth = s.mul_add(inverse[0], x, iy);
                let start = (by * self.blocks_wide + bx) * SIDE * SIDE;
                let pixels = &mut self.inverse[start..start + SIDE * SIDE];
                let old = s.load(pixels);
                // NaN fails the test; a clamped value does not: test first.
                let nearer = s.and(
                    inside,
                    s.and(s.lt(zero, depth), s.lt(depth, s.splat(f32::INFINITY))),
                );
                let depth = s.max(s.min(depth, most), least);
                let new = s.select(s.and(nearer, s.lt(old, depth)), depth, old);
                s.store(new, pixels);
                self.stale[by / SIDE * self.tiles_wide + bx / SIDE] = true;
            }
        }
    }

    #[inline(always)]
    fn resolve(&self, lanes: L, view: &View, out: &mut [f32], width: usize, height: usize) {
        let s = lanes.s16();
        let one = s.splat(1.0);
        let (rx, ry) = (s.splat(self.fx), s.splat(self.fy));
        for by in 0..self.blocks_high {
            let y = s.div(s.add(self.rows, s.splat((by * SIDE) as f32 - self.cy)), ry);
            for bx in 0..self.blocks_wide {
                let x = s.div(
                    s.add(self.columns, s.splat((bx * SIDE) as f32 - self.cx)),
                    rx,
                );
                let start = (by * self.blocks_wide + bx) * SIDE * SIDE;
                let z = s.div(one, s.load(&self.inverse[start..start + SIDE * SIDE]));
                let mut depth = [0.0; 16];
                s.store(view.depth(s, z, x, y), &mut depth);
                let wide = SIDE.min(width - bx * SIDE);
                for row in 0..SIDE.min(height - by * SIDE) {
                    let to = (by * SIDE + row) * width + bx * SIDE;
                    out[to..to + wide].copy_from_slice(&depth[row * SIDE..row * SIDE + wide]);
                }
            }
        }
    }
}

/// Pixel bounds of the part of a triangle (in the camera's frame) that lies ahead of the camera.
#[cold]
fn bounds_ahead(
    corners: [Vec3; 3],
    [fx, fy, cx, cy]: [f32; 4],
    width: f32,
    height: f32,
) -> Option<[usize; 4]> {
    let mut low = [f32::INFINITY; 2];
    let mut high = [f32::NEG_INFINITY; 2];
    let mut take = |p: Vec3| {
        let at = [p.x / p.z * fx + cx - 0.5, p.y / p.z * fy + cy - 0.5];
        for axis in 0..2 {
            low[axis] = low[axis].min(at[axis]);
            high[axis] = high[axis].max(at[axis]);
        }
    };
    for i in 0..3 {
        let (p, q) = (corners[i], corners[(i + 1) % 3]);
        if p.z > CUT {
            take(p);
        }
        if (p.z > CUT) != (q.z > CUT) {
            let at = p + (q - p) * ((CUT - p.z) / (q.z - p.z));
            take(Vec3::new(at.x, at.y, CUT));
        }
    }
    // The cut is found with an error that the division by a small z makes large.
    let margin = 2.0;
    let (left, right) = (
        (low[0] - margin).max(0.0),
        (high[0] + margin).min(width - 1.0),
    );
    let (top, bottom) = (
        (low[1] - margin).max(0.0),
        (high[1] + margin).min(height - 1.0),
    );
    (left <= right && top <= bottom).then_some([
        left as usize,
        right as usize,
        top as usize,
        bottom as usize,
    ])
}
