//! Where a camera may be put: view spaces, and whether the robot may go there as far as it knows.
use super::octree::{KeyBox, Octree, State};
use crate::capsule::Capsule;
use crate::error::{positive, Error, Result};
use crate::geometry::{Aabb, IVec3, Pose, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use std::f32::consts::TAU;

/// Most viewpoints of a view space.
const MAX_VIEWS: usize = 1 << 20;
const MAX_LENGTH: f64 = 1000.0;
/// Farthest neighbours, steps.
const MAX_REACH: usize = 64;

/// The candidate views of a task.
#[derive(Clone, Debug, PartialEq)]
pub enum ViewSpace {
    /// The current view moved by `step` metres up, down, forward, backward, right, left; the heading is kept.
    SixDirections { step: f32 },
    /// Views on a sphere around an anchor that look outward along the radius (Wang 2019); see [`dome`].
    Dome {
        rings: usize,
        per_ring: usize,
        radius: f32,
        min_pitch: f32,
        max_pitch: f32,
        /// Neighbours are up to so many headings and pitches apart.
        reach: usize,
    },
    /// Views around an object that look inward at its centre (Potthast & Sukhatme 2014); see [`ring`].
    Ring {
        positions: usize,
        radius: f32,
        pitches: Vec<f32>,
        /// As of a dome.
        reach: usize,
    },
}

impl ViewSpace {
    pub fn six_directions(step: f64) -> Result<Self> {
        Ok(Self::SixDirections {
            step: length("views step", step)?,
        })
    }

    pub fn dome(
        rings: usize,
        per_ring: usize,
        radius: f64,
        min_pitch: f64,
        max_pitch: f64,
    ) -> Result<Self> {
        check_count("dome", rings, per_ring)?;
        let quarter = std::f64::consts::FRAC_PI_2;
        if !(-quarter <= min_pitch && min_pitch <= max_pitch && max_pitch <= quarter) {
            return Err(Error::invalid(format!(
                "dome min_pitch <= max_pitch must lie in [-pi/2, pi/2] rad, got {min_pitch} and {max_pitch}"
            )));
        }
        Ok(Self::Dome {
            rings,
            per_ring,
            radius: length("dome radius", radius)?,
            min_pitch: min_pitch as f32,
            max_pitch: max_pitch as f32,
            reach: 1,
        })
    }

    pub fn ring(positions: usize, radius: f64, pitches: Vec<f64>) -> Result<Self> {
        check_count("ring", positions, pitches.len())?;
        if let Some(p) = pitches
            .iter()
            .find(|p| p.is_nan() || p.abs() > std::f64::consts::FRAC_PI_2)
        {
            return Err(Error::invalid(format!(
                "ring pitches must lie in [-pi/2, pi/2] rad, got {p}"
            )));
        }
        Ok(Self::Ring {
            positions,
            radius: length("ring radius", radius)?,
            pitches: pitches.into_iter().map(|p| p as f32).collect(),
            reach: 1,
        })
    }

    /// A dome or a ring whose views have all those up to `steps` headings and pitches away for neighbours.
    pub fn with_reach(mut self, steps: usize) -> Result<Self> {
        if let Self::Dome { reach, .. } | Self::Ring { reach, .. } = &mut self {
            if !(1..=MAX_REACH).contains(&steps) {
                return Err(Error::invalid(format!(
                    "views reach must be in 1..={MAX_REACH} steps, got {steps}"
                )));
            }
            *reach = steps;
        }
        Ok(self)
    }

    /// The candidates, given the camera's pose (six directions) or the centre of dome or ring.
    pub fn views(&self, pose: &Pose, anchor: Vec3) -> Vec<Pose> {
        match self {
            Self::SixDirections { step } => six_directions(pose, *step).to_vec(),
            Self::Dome {
                rings,
                per_ring,
                radius,
                min_pitch,
                max_pitch,
                ..
            } => dome(anchor, *rings, *per_ring, *radius, *min_pitch, *max_pitch),
            Self::Ring {
                positions,
                radius,
                pitches,
                ..
            } => ring(anchor, *radius, *positions, pitches),
        }
    }

    /// Number of candidates.
    pub fn count(&self) -> usize {
        match self {
            Self::SixDirections { .. } => 6,
            Self::Dome {
                rings, per_ring, ..
            } => rings * per_ring,
            Self::Ring {
                positions, pitches, ..
            } => positions * pitches.len(),
        }
    }

    /// Are the candidates the same during an episode?
    pub fn is_fixed(&self) -> bool {
        !matches!(self, Self::SixDirections { .. })
    }

    /// Candidates next to candidate `index` in a fixed view space, ascending: up to eight on a dome or a ring, more where its
    /// reach is longer. Empty for six directions and for an index that does not exist.
    pub fn neighbours(&self, index: usize) -> Vec<usize> {
        match self {
            Self::SixDirections { .. } => Vec::new(),
            Self::Dome {
                rings,
                per_ring,
                reach,
                ..
            } => dome_neighbours(*rings, *per_ring, *reach, index),
            Self::Ring {
                positions,
                pitches,
                reach,
                ..
            } => dome_neighbours(pitches.len(), *positions, *reach, index),
        }
    }
}

/// Metres from one view to the next or to the middle; longer than any scene is a mistake.
fn length(name: &str, metres: f64) -> Result<f32> {
    if positive(name, metres)? <= MAX_LENGTH {
        return Ok(metres as f32);
    }
    Err(Error::invalid(format!(
        "{name} must be at most {MAX_LENGTH} m, got {metres}"
    )))
}

fn check_count(name: &str, rows: usize, columns: usize) -> Result<()> {
    match rows.checked_mul(columns) {
        Some(n) if (1..=MAX_VIEWS).contains(&n) => Ok(()),
        _ => Err(Error::invalid(format!(
            "{name} must have 1..={MAX_VIEWS} views, got {rows} x {columns}"
        ))),
    }
}

/// The view moved by `step` metres in the heading's frame: up, down, forward, backward, right, left.
/// Up is world +z; forward and right are horizontal. The orientation is kept.
pub fn six_directions(view: &Pose, step: f32) -> [Pose; 6] {
    let (sin, cos) = view.yaw().sin_cos();
    let (forward, right) = (Vec3::new(cos, sin, 0.0), Vec3::new(sin, -cos, 0.0));
    [Vec3::Z, -Vec3::Z, forward, -forward, right, -right]
        .map(|d| Pose::new(view.translation + d * step, view.rotation))
}

/// Views on a sphere of `radius` metres around `anchor` that look outward along the radius. View number
/// `ring * per_ring + i` has heading `i * 2 pi / per_ring` and a pitch that goes from `min_pitch` (ring 0) to
/// `max_pitch` (last ring), radians.
///
/// Wang 2019 gives neither grid nor radius, only 672 poses whose neighbours overlap by at least 80 %. 14 rings of 48
/// from -35 to 60 degrees have 7.5 degrees between headings and 7.3 between pitches: 87 % of a field of view 60 degrees
/// wide and 84 % of one 46 degrees high.
pub fn dome(
    anchor: Vec3,
    rings: usize,
    per_ring: usize,
    radius: f32,
    min_pitch: f32,
    max_pitch: f32,
) -> Vec<Pose> {
    let step = (max_pitch - min_pitch) / rings.saturating_sub(1).max(1) as f32;
    (0..rings)
        .flat_map(|r| (0..per_ring).map(move |i| (r, i)))
        .map(|(r, i)| {
            let (yaw, pitch) = (
                i as f32 * TAU / per_ring as f32,
                min_pitch + r as f32 * step,
            );
            Pose::from_yaw_pitch(anchor + direction(yaw, pitch) * radius, yaw, pitch)
        })
        .collect()
}

/// Views up to `reach` headings and pitches from view `index` of a dome: the ring is closed, the pitches end. Ascending.
pub fn dome_neighbours(rings: usize, per_ring: usize, reach: usize, index: usize) -> Vec<usize> {
    if per_ring == 0 || index >= rings * per_ring {
        return Vec::new();
    }
    let (ring, i) = (index / per_ring, index % per_ring);
    // Once around at most.
    let headings = (2 * reach + 1).min(per_ring);
    let mut neighbours: Vec<usize> = (ring.saturating_sub(reach)..=(ring + reach).min(rings - 1))
        .flat_map(|r| {
            let first = i + per_ring - headings / 2;
            (0..headings).map(move |d| r * per_ring + (first + d) % per_ring)
        })
        .filter(|n| *n != index)
        .collect();
    neighbours.sort_unstable();
    neighbours
}

/// Views at `radius` metres from `center` that look at it: for each elevation in `pitches` (radians, the camera is above
/// the centre where positive) `positions` headings around the circle, the first at +x.
pub fn ring(center: Vec3, radius: f32, positions: usize, pitches: &[f32]) -> Vec<Pose> {
    pitches
        .iter()
        .flat_map(|pitch| (0..positions).map(move |i| (*pitch, i as f32 * TAU / positions as f32)))
        .map(|(pitch, yaw)| Pose::looking_at(center + direction(yaw, pitch) * radius, center))
        .collect()
}

fn direction(yaw: f32, pitch: f32) -> Vec3 {
    Vec3::new(
        yaw.cos() * pitch.cos(),
        yaw.sin() * pitch.cos(),
        pitch.sin(),
    )
}

/// `count` views, uniform in the known free space that keeps `clearance` metres from everything occupied, with random
/// heading and level. Fewer if 100 draws a view do not find as many.
pub fn uniform_in_free_space(
    octree: &Octree,
    count: usize,
    rng: &mut Pcg64Mcg,
    clearance: f32,
) -> Vec<Pose> {
    let mut below = Vec::with_capacity(octree.bricks().len());
    let mut total = 0u64;
    for brick in octree.bricks() {
        total += (0..8)
            .map(|w| u64::from((brick.known[w] & !brick.occupied[w]).count_ones()))
            .sum::<u64>();
        below.push(total);
    }
    let mut views = Vec::new();
    for _ in 0..count.saturating_mul(100) {
        if total == 0 || views.len() == count {
            break;
        }
        let mut n = rng.random_range(0..total);
        let offset = Vec3::from_array(std::array::from_fn(|_| rng.random::<f32>() - 0.5));
        let yaw = rng.random::<f32>() * TAU;
        let number = below.partition_point(|b| *b <= n);
        n -= number.checked_sub(1).map_or(0, |i| below[i]);
        let brick = &octree.bricks()[number];
        for word in 0..8 {
            let mut free = brick.known[word] & !brick.occupied[word];
            let ones = u64::from(free.count_ones());
            if n >= ones {
                n -= ones;
                continue;
            }
            for _ in 0..n {
                free &= free - 1;
            }
            let bit = free.trailing_zeros() as i32;
            let key = (octree.brick_coordinates(number) << 3)
                + IVec3::new(bit & 7, bit >> 3, word as i32);
            // A hair less than the voxel, so that rounding cannot leave it.
            let point = octree.center(key) + offset * (0.999 * octree.resolution() as f32);
            if sphere_is_clear(octree, point, clearance, true) {
                views.push(Pose::from_yaw_pitch(point, yaw, 0.0));
            }
            break;
        }
    }
    views
}

/// May the robot's body (a sphere of `radius` metres around the camera) be there: its centre inside the bounds, and no
/// occupied voxel within the body. Unknown space does not forbid it.
pub fn admissible(octree: &Octree, bounds: &Aabb, view: &Pose, radius: f32) -> bool {
    bounds.contains(view.translation) && sphere_is_clear(octree, view.translation, radius, true)
}

/// Is there no occupied (and, unless `unknown_is_free`, no unknown) voxel nearer than `radius` metres, nor the point's
/// own? `false` outside the map's key space.
pub fn sphere_is_clear(octree: &Octree, center: Vec3, radius: f32, unknown_is_free: bool) -> bool {
    segment_is_clear(octree, center, center, radius, unknown_is_free)
}

/// Does a sphere of `radius` metres around a point overlap a voxel?
#[inline]
pub fn is_touched(octree: &Octree, center: Vec3, radius: f32, key: IVec3) -> bool {
    let radius = smallest_body(octree).max(radius);
    let (low, high) = Sweep::new(octree, center, center, radius).faces(key);
    gap(low, high, center) < radius
}

/// A point still overlaps the voxel that it is in.
fn smallest_body(octree: &Octree) -> f32 {
    1e-4 * octree.resolution() as f32
}

/// Can a sphere of `radius` metres move straight from `a` to `b` without coming to an occupied (and, unless
/// `unknown_is_free`, an unknown) voxel? Exact for voxels as boxes. A voxel that the sphere overlaps at `a` already
/// blocks only a motion that comes closer to it: a robot in contact may go away. `false` outside the key space.
pub fn segment_is_clear(
    octree: &Octree,
    a: Vec3,
    b: Vec3,
    radius: f32,
    unknown_is_free: bool,
) -> bool {
    is_clear(octree, a, b, radius, unknown_is_free, true)
}

/// Does no occupied voxel overlap this capsule? Exact for voxels as boxes; unknown ones do not count. `false` outside
/// the key space.
pub fn capsule_is_clear(octree: &Octree, capsule: &Capsule) -> bool {
    is_clear(octree, capsule.a, capsule.b, capsule.radius, true, false)
}

/// As [`segment_is_clear`]; what is overlapped at `a` may only be forgiven to what moves.
fn is_clear(
    octree: &Octree,
    a: Vec3,
    b: Vec3,
    radius: f32,
    unknown_is_free: bool,
    moves: bool,
) -> bool {
    let (Some(_), Some(_)) = (octree.key(a), octree.key(b)) else {
        return false;
    };
    let radius = smallest_body(octree).max(radius);
    let region = KeyBox::touching(octree, &Aabb::of([a, b]).grown(radius));
    let mut sweep = Sweep::new(octree, a, b, radius);
    sweep.forgives = moves;
    let blocks = |corner: IVec3, word: usize, mut bits: u64| {
        while bits != 0 {
            let bit = bits.trailing_zeros() as i32;
            bits &= bits - 1;
            if sweep.is_blocked_by((corner << 3) + IVec3::new(bit & 7, bit >> 3, word as i32)) {
                return true;
            }
        }
        false
    };
    let (low, high): (IVec3, IVec3) = (region.min >> 3, (region.max - 1) >> 3);
    for z in low.z..=high.z {
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let corner = IVec3::new(x, y, z);
                let brick = octree
                    .root()
                    .index(corner)
                    .and_then(|cell| octree.root().brick(cell));
                let brick = brick.map(|number| &octree.bricks()[number]);
                // Most bricks hold nothing that could block: look there before measuring.
                let empty = brick.is_none_or(|b| b.occupied == [0; 8]);
                if (empty && unknown_is_free) || !sweep.is_near_brick(corner) {
                    continue;
                }
                let mask = region.mask(corner);
                for (word, mask) in mask.into_iter().enumerate() {
                    let obstacles = match (brick, unknown_is_free) {
                        (Some(brick), true) => brick.occupied[word],
                        (Some(brick), false) => brick.occupied[word] | !brick.known[word],
                        (None, _) => u64::MAX,
                    };
                    if obstacles & mask != 0 && blocks(corner, word, obstacles & mask) {
                        return false;
                    }
                }
            }
        }
    }
    true
}

/// A sphere on its way from `start` along `motion`.
struct Sweep {
    start: Vec3,
    motion: Vec3,
    radius: f32,
    resolution: f64,
    /// Whether a voxel that is overlapped at the start blocks only if the sphere comes closer.
    forgives: bool,
}

impl Sweep {
    fn new(octree: &Octree, a: Vec3, b: Vec3, radius: f32) -> Self {
        Self {
            start: a,
            motion: b - a,
            radius,
            resolution: octree.resolution(),
            forgives: true,
        }
    }

    fn at(&self, t: f32) -> Vec3 {
        self.start + self.motion * t
    }

    /// Distance of a point to the segment.
    fn distance(&self, p: Vec3) -> f32 {
        let squared = self.motion.length_squared();
        let t = if squared > 0.0 {
            (p - self.start).dot(self.motion) / squared
        } else {
            0.0
        };
        self.at(t.clamp(0.0, 1.0)).distance(p)
    }

    fn is_near_brick(&self, corner: IVec3) -> bool {
        let side = 8.0 * self.resolution as f32;
        let center = (corner.as_vec3() + 0.5) * side;
        self.distance(center) <= self.radius + 0.87 * side
    }

    /// The corners of a voxel.
    #[inline]
    fn faces(&self, key: IVec3) -> (Vec3, Vec3) {
        let edge = |k: i32| (f64::from(k) * self.resolution) as f32;
        let corner = |k: IVec3| Vec3::new(edge(k.x), edge(k.y), edge(k.z));
        (corner(key), corner(key + 1))
    }

    fn is_blocked_by(&self, key: IVec3) -> bool {
        let (low, high) = self.faces(key);
        if self.distance((low + high) * 0.5) > self.radius + 0.87 * self.resolution as f32 {
            return false;
        }
        // Convex along the line, as the voxel is.
        let gap = |t: f32| gap(low, high, self.at(t));
        let touched = gap(0.0);
        if self.motion == Vec3::ZERO {
            return touched < self.radius;
        }
        let (mut from, mut to) = (0.0f32, 1.0f32);
        for _ in 0..40 {
            let third = (to - from) / 3.0;
            if gap(from + third) <= gap(to - third) {
                to -= third;
            } else {
                from += third;
            }
        }
        let nearest = gap(from).min(gap(to)).min(gap(1.0));
        if !self.forgives {
            return nearest.min(touched) < self.radius;
        }
        nearest < self.radius.min(touched - 1e-3 * self.resolution as f32)
    }
}

/// Distance of a point to a box, below zero inside.
#[inline]
fn gap(low: Vec3, high: Vec3, p: Vec3) -> f32 {
    let outside = (low - p).max(p - high);
    outside.max(Vec3::ZERO).length() + outside.max_element().min(0.0)
}

/// The state at a point; unknown outside the map's key space.
pub fn state_at(octree: &Octree, p: Vec3) -> State {
    octree.key(p).map_or(State::Unknown, |k| octree.state(k))
}

#[cfg(test)]
mod tests;
