//! Ground plans: oriented rectangles, the blocks that stand on them, and distances in the plane.
use glam::Vec2;

/// An oriented rectangle in the plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Footprint {
    pub center: Vec2,
    pub half: Vec2,
    /// Unit vector along the side of length `2 half.x`.
    pub axis: Vec2,
}

impl Footprint {
    pub fn new(center: Vec2, half: Vec2, yaw: f32) -> Self {
        let axis = Vec2::from_angle(yaw);
        Self { center, half, axis }
    }

    pub fn corners(&self) -> [Vec2; 4] {
        let u = self.axis * self.half.x;
        let v = self.axis.perp() * self.half.y;
        let c = self.center;
        [c - u - v, c + u - v, c + u + v, c - u + v]
    }

    /// Moved by `yaw` (given as the unit vector `turn`) about the origin and then by `offset`.
    pub fn moved(&self, turn: Vec2, offset: Vec2) -> Self {
        Self {
            center: turn.rotate(self.center) + offset,
            half: self.half,
            axis: turn.rotate(self.axis),
        }
    }

    pub fn grown(&self, margin: f32) -> Self {
        Self {
            half: self.half + margin,
            ..*self
        }
    }

    /// Do the interiors of two rectangles overlap by more than `tolerance`? (Separating axes.)
    pub fn overlaps(&self, other: &Footprint, tolerance: f32) -> bool {
        let d = other.center - self.center;
        let reach = self.half.length() + other.half.length();
        if d.length_squared() >= reach * reach {
            return false;
        }
        let radius = |f: &Footprint, axis: Vec2| {
            f.half.x * f.axis.dot(axis).abs() + f.half.y * f.axis.perp_dot(axis).abs()
        };
        [self.axis, self.axis.perp(), other.axis, other.axis.perp()]
            .into_iter()
            .all(|a| d.dot(a).abs() < radius(self, a) + radius(other, a) - tolerance)
    }

    /// False only if the distance is more than `reach`.
    pub fn is_near(&self, point: Vec2, reach: f32) -> bool {
        let reach = reach + self.half.x + self.half.y;
        self.center.distance_squared(point) <= reach * reach
    }

    /// Distance from `point` to the rectangle, 0 inside.
    pub fn distance(&self, point: Vec2) -> f32 {
        let d = point - self.center;
        let local = Vec2::new(d.dot(self.axis).abs(), d.dot(self.axis.perp()).abs());
        (local - self.half).max(Vec2::ZERO).length()
    }
}

/// A footprint with a height range: what a piece of furniture, or a part of it, fills.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Block {
    pub footprint: Footprint,
    pub z: [f32; 2],
}

impl Block {
    pub fn new(center: Vec2, half: Vec2, yaw: f32, z: [f32; 2]) -> Self {
        let footprint = Footprint::new(center, half, yaw);
        Self { footprint, z }
    }

    /// Touching (up to a millimetre) is no overlap: things stand on each other and in rows.
    pub fn overlaps(&self, other: &Block) -> bool {
        const TOUCH: f32 = 1e-3;
        self.z[0] < other.z[1] - TOUCH
            && other.z[0] < self.z[1] - TOUCH
            && self.footprint.overlaps(&other.footprint, TOUCH)
    }

    pub fn moved(&self, turn: Vec2, offset: Vec2, lift: f32) -> Self {
        Self {
            footprint: self.footprint.moved(turn, offset),
            z: self.z.map(|z| z + lift),
        }
    }

    /// Distance from a point in space to the block, 0 inside.
    pub fn distance(&self, point: Vec2, z: f32) -> f32 {
        let below = (self.z[0] - z).max(z - self.z[1]).max(0.0);
        let beside = self.footprint.distance(point);
        (beside * beside + below * below).sqrt()
    }
}

/// Does the simple polygon contain the point? (Even-odd rule.)
pub(super) fn contains(polygon: &[Vec2], p: Vec2) -> bool {
    let mut inside = false;
    for (a, b) in edges(polygon) {
        if (a.y > p.y) != (b.y > p.y) && p.x < a.x + (b.x - a.x) * (p.y - a.y) / (b.y - a.y) {
            inside = !inside;
        }
    }
    inside
}

pub(super) fn edges(polygon: &[Vec2]) -> impl Iterator<Item = (Vec2, Vec2)> + '_ {
    (0..polygon.len()).map(|i| (polygon[i], polygon[(i + 1) % polygon.len()]))
}

/// Distance from `p` to the polygon's border.
pub(super) fn border_distance(polygon: &[Vec2], p: Vec2) -> f32 {
    edges(polygon)
        .map(|(a, b)| {
            let t = (p - a).dot(b - a) / (b - a).length_squared().max(1e-12);
            (a + (b - a) * t.clamp(0.0, 1.0)).distance(p)
        })
        .fold(f32::INFINITY, f32::min)
}

pub(super) fn area(polygon: &[Vec2]) -> f32 {
    0.5 * edges(polygon).map(|(a, b)| a.perp_dot(b)).sum::<f32>()
}

/// Every edge of a counter-clockwise polygon moved outwards by `distance`, corners mitred.
pub(super) fn offset(polygon: &[Vec2], distance: f32) -> Vec<Vec2> {
    let n = polygon.len();
    (0..n)
        .map(|i| {
            let [a, b, c] = [polygon[(i + n - 1) % n], polygon[i], polygon[(i + 1) % n]];
            let u = (b - a).normalize_or_zero();
            let v = (c - b).normalize_or_zero();
            // Outward normals of both edges; their sum points to the mitred corner.
            let (nu, nv) = (-u.perp(), -v.perp());
            b + (nu + nv) * (distance / (1.0 + nu.dot(nv)).max(0.1))
        })
        .collect()
}
