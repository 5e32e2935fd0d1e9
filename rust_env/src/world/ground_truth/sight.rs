//! Which surface voxels can be seen: images find most of them, rays look for the rest.
use super::voxels::{Surface, VoxelSet};
use crate::camera::{Camera, DepthKind};
use crate::geometry::{Aabb, IVec3, Mat3, Mesh, Pose, Vec3};
use crate::world::render::DepthRenderer;

/// From where a task may look.
pub enum Sight<'a> {
    /// Only these viewpoints, within the camera's frustum.
    Views(&'a [Pose]),
    /// Any orientation from these positions.
    Positions(&'a [Vec3]),
}

/// Pixels of all images of the first pass together.
const PIXELS: usize = 160_000;
/// Eyes tried for a voxel next to a visible one, and for one that is alone or among others tried in vain.
const EYES: usize = 16;
const FEW_EYES: usize = 3;
/// Neighbours tried in vain that make a voxel's chances poor.
const IN_VAIN: usize = 4;
/// Surface points tried in a voxel.
const POINTS: usize = 12;
/// Of these, pieces of triangles that are tried at their corners too.
const PIECES: usize = 2;
/// Cells that eyes are sorted into, metres.
const CELL: f32 = 0.8;

/// The voxels of `surface` of which some eye sees a point within `range`. Every member was hit by a ray.
pub(super) fn visible(
    surface: &Surface,
    mesh: &Mesh,
    renderer: &DepthRenderer,
    range: f32,
    camera: &Camera,
    sight: &Sight,
) -> VoxelSet {
    let mut search = Search {
        visible: surface.voxels.cleared(),
        surface,
        renderer,
        range,
        fresh: Vec::new(),
    };
    match sight {
        Sight::Views(views) => search.images_of_views(views, camera),
        Sight::Positions(positions) => search.images_all_round(positions),
    }
    let eyes = Eyes::new(sight, camera, range);
    let hidden = Hidden::new(surface, &search.visible, &eyes);
    // Visible surfaces hang together: from each voxel found, its neighbours are tried next, first from the same eye.
    // What the images missed is seen from few eyes: only those found later are hints worth a second visit. Hidden
    // surfaces hang together too: where neighbours were tried in vain, few rays must do.
    let mut visited = vec![false; hidden.keys.len()];
    let mut in_vain = surface.voxels.cleared();
    let mut in_images = std::mem::take(&mut search.fresh);
    let mut next = 0;
    loop {
        let found_later = search.fresh.pop();
        if let Some((key, eye)) = found_later.or_else(|| in_images.pop()) {
            hidden.for_neighbours(key, |i| {
                let again = std::mem::replace(&mut visited[i], true);
                if search.visible.contains(hidden.keys[i]) || (again && found_later.is_none()) {
                    return;
                }
                let points = hidden.points(i, mesh, surface.resolution);
                let hints = if found_later.is_some() {
                    points.len()
                } else {
                    PIECES.min(points.len())
                };
                if search.look_from(hidden.keys[i], &points[..hints], &eyes, eye) || again {
                    return;
                }
                let poor = around(hidden.keys[i])
                    .filter(|k| in_vain.contains(*k))
                    .take(IN_VAIN)
                    .count()
                    == IN_VAIN;
                if poor {
                    search.look_for(hidden.keys[i], &points, &eyes, FEW_EYES, 1);
                } else if !search.look_for(hidden.keys[i], &points, &eyes, EYES, 3) {
                    in_vain.insert(hidden.keys[i]);
                }
            });
            continue;
        }
        let Some(i) = (next..hidden.keys.len()).find(|&i| !visited[i]) else {
            return search.visible;
        };
        next = i + 1;
        let points = hidden.points(i, mesh, surface.resolution);
        search.look_for(hidden.keys[i], &points, &eyes, FEW_EYES, 1);
    }
}

/// The 26 voxels around one.
fn around(key: IVec3) -> impl Iterator<Item = IVec3> {
    (0..27)
        .filter(|i| *i != 13)
        .map(move |i| key + IVec3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1))
}

struct Search<'a> {
    visible: VoxelSet,
    surface: &'a Surface,
    renderer: &'a DepthRenderer,
    range: f32,
    /// Voxels found since their neighbours were tried, and the eye that found them.
    fresh: Vec<(IVec3, usize)>,
}

impl Search<'_> {
    /// Takes in the voxels that a point of a surface belongs to.
    fn mark(&mut self, point: Vec3, eye: usize) {
        let (low, high) = self.surface.keys(point);
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                for x in low.x..=high.x {
                    let key = IVec3::new(x, y, z);
                    if self.surface.voxels.contains(key) && self.visible.insert(key) {
                        self.fresh.push((key, eye));
                    }
                }
            }
        }
    }

    fn image(&mut self, camera: &Camera, view: &Pose, eye: usize, depth: &mut Vec<f32>) {
        depth.resize(camera.pixels(), 0.0);
        self.renderer.render(camera, view, depth);
        for v in 0..camera.height {
            for u in 0..camera.width {
                let range = depth[v * camera.width + u];
                if range > 0.0 && range.is_finite() {
                    self.mark(camera.unproject(view, u, v, range), eye);
                }
            }
        }
    }

    /// Images of some of the views, evenly picked, with the camera's field of view and fewer pixels.
    fn images_of_views(&mut self, views: &[Pose], camera: &Camera) {
        let shrink = (camera.pixels() as f32 / 4096.0).sqrt().max(1.0);
        let small = |side: usize| ((side as f32 / shrink) as usize).clamp(1, side);
        let (width, height) = (small(camera.width), small(camera.height));
        let (sx, sy) = (
            width as f32 / camera.width as f32,
            height as f32 / camera.height as f32,
        );
        let camera = Camera {
            width,
            height,
            fx: camera.fx * sx,
            fy: camera.fy * sy,
            cx: camera.cx * sx,
            cy: camera.cy * sy,
            near: 0.0,
            far: self.range,
            kind: DepthKind::Range,
        };
        let mut depth = Vec::new();
        for i in spread(views.len(), PIXELS / camera.pixels()) {
            self.image(&camera, &views[i], i, &mut depth);
        }
    }

    /// Six images from each of some positions.
    fn images_all_round(&mut self, positions: &[Vec3]) {
        const SIDE: usize = 40;
        let camera = Camera {
            width: SIDE,
            height: SIDE,
            fx: SIDE as f32 / 2.0,
            fy: SIDE as f32 / 2.0,
            cx: SIDE as f32 / 2.0,
            cy: SIDE as f32 / 2.0,
            near: 0.0,
            far: self.range,
            kind: DepthKind::Range,
        };
        // One position a cell: the lattice is finer than sight needs.
        let cells = Cells::new(positions);
        let firsts: Vec<usize> = cells.starts.iter().map(|&s| cells.order[s]).collect();
        let mut depth = Vec::new();
        for i in spread(
            firsts.len(),
            (PIXELS / (6 * camera.pixels())).max(firsts.len() / 8),
        ) {
            let eye = firsts[i];
            let from = positions[eye];
            for axis in [
                Vec3::X,
                Vec3::Y,
                Vec3::Z,
                Vec3::NEG_X,
                Vec3::NEG_Y,
                Vec3::NEG_Z,
            ] {
                self.image(
                    &camera,
                    &Pose::looking_at(from, from + axis),
                    eye,
                    &mut depth,
                );
            }
        }
    }

    /// Looks for one voxel from an eye.
    fn look_from(&mut self, key: IVec3, points: &[Vec3], eyes: &Eyes, eye: usize) -> bool {
        points.iter().any(|point| self.sees(key, *point, eyes, eye))
    }

    /// Looks for one voxel from up to `many` eyes: each at the middle of the largest piece and at some other points.
    fn look_for(
        &mut self,
        key: IVec3,
        points: &[Vec3],
        eyes: &Eyes,
        many: usize,
        points_each: usize,
    ) -> bool {
        if points.is_empty() {
            return false;
        }
        let resolution = self.surface.resolution;
        let center = ((key.as_dvec3() + 0.5) * resolution).as_vec3();
        let mut found = [0; EYES];
        let count = eyes.find(center, resolution as f32, &mut found[..many]);
        for (rank, &eye) in found[..count].iter().enumerate() {
            for k in 0..points_each {
                let point = if k == 0 {
                    0
                } else {
                    rank * (points_each - 1) + k
                };
                if self.sees(key, points[point % points.len()], eyes, eye) {
                    return true;
                }
            }
        }
        false
    }

    /// Casts a ray from an eye to a point; whatever the ray meets is marked. True if `key` is visible now.
    fn sees(&mut self, key: IVec3, point: Vec3, eyes: &Eyes, eye: usize) -> bool {
        let origin = eyes.positions[eye];
        let Some(direction) = (point - origin).try_normalize() else {
            return false;
        };
        if !eyes.in_view(eye, point) {
            return false;
        }
        let Some(t) = self.renderer.cast(origin, direction, self.range) else {
            return false;
        };
        self.mark(origin + direction * t, eye);
        self.visible.contains(key)
    }
}

/// Surface voxels in range of the eyes that the images did not show, with their triangles.
struct Hidden {
    voxels: VoxelSet,
    keys: Vec<IVec3>,
    /// Triangles of voxel i: `triangles[first[i]..first[i + 1]]`.
    first: Vec<usize>,
    triangles: Vec<u32>,
}

impl Hidden {
    fn new(surface: &Surface, visible: &VoxelSet, eyes: &Eyes) -> Self {
        let reach = eyes.reach(surface.resolution);
        let mut pairs: Vec<([i32; 3], u32)> = surface
            .touches
            .iter()
            .filter(|(key, _)| {
                key.cmpge(reach.0).all() && key.cmple(reach.1).all() && !visible.contains(*key)
            })
            .map(|(key, t)| ([key.z, key.y, key.x], *t))
            .collect();
        pairs.sort_unstable();
        let mut hidden = Self {
            voxels: surface.voxels.cleared(),
            keys: Vec::new(),
            first: Vec::new(),
            triangles: pairs.iter().map(|p| p.1).collect(),
        };
        for (i, ([z, y, x], _)) in pairs.iter().enumerate() {
            let key = IVec3::new(*x, *y, *z);
            if hidden.keys.last() != Some(&key) {
                hidden.voxels.insert(key);
                hidden.keys.push(key);
                hidden.first.push(i);
            }
        }
        hidden.first.push(pairs.len());
        hidden
    }

    /// Calls `visit` with the numbers of the hidden voxels among the 26 around `key`.
    fn for_neighbours(&self, key: IVec3, mut visit: impl FnMut(usize)) {
        for near in around(key).filter(|k| self.voxels.contains(*k)) {
            let order = |k: &IVec3| (k.z, k.y, k.x).cmp(&(near.z, near.y, near.x));
            if let Ok(i) = self.keys.binary_search_by(order) {
                visit(i);
            }
        }
    }

    /// Points of the surface within voxel i: middles of its largest pieces of triangles, then points near their corners.
    fn points(&self, i: usize, mesh: &Mesh, resolution: f64) -> Points {
        let mut pieces: [Option<Piece>; PIECES] = [None; PIECES];
        let center = (self.keys[i].as_dvec3() + 0.5) * resolution;
        for &t in &self.triangles[self.first[i]..self.first[i + 1]] {
            let corners = mesh
                .corners(t as usize)
                .map(|c| (c.as_dvec3() - center).as_vec3());
            let mut new = Piece::new(corners, resolution as f32 / 2.0 + 1e-5);
            for slot in &mut pieces {
                let larger = match (&new, &slot) {
                    (Some(new), Some(old)) => new.area > old.area,
                    (new, _) => new.is_some(),
                };
                if larger {
                    std::mem::swap(slot, &mut new);
                }
            }
        }
        let center = center.as_vec3();
        let mut points = Points::default();
        for piece in pieces.iter().flatten() {
            points.push(center + piece.middle);
        }
        for piece in pieces.iter().flatten() {
            for corner in &piece.polygon[..piece.count] {
                points.push(center + corner.lerp(piece.middle, 0.1));
            }
        }
        points
    }
}

/// A short list of points.
#[derive(Default)]
struct Points {
    list: [Vec3; POINTS],
    count: usize,
}

impl Points {
    /// What does not fit is left out.
    fn push(&mut self, point: Vec3) {
        if let Some(slot) = self.list.get_mut(self.count) {
            *slot = point;
            self.count += 1;
        }
    }
}

impl std::ops::Deref for Points {
    type Target = [Vec3];
    fn deref(&self) -> &[Vec3] {
        &self.list[..self.count]
    }
}

/// The part of a triangle within a voxel.
#[derive(Clone, Copy)]
struct Piece {
    polygon: [Vec3; 10],
    count: usize,
    area: f32,
    middle: Vec3,
}

impl Piece {
    /// The part of a triangle within the cube of half side `half` around the origin.
    fn new(corners: [Vec3; 3], half: f32) -> Option<Self> {
        // A triangle clipped by six planes has at most nine corners.
        let mut polygon = [Vec3::ZERO; 10];
        polygon[..3].copy_from_slice(&corners);
        let mut count = 3;
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let inside = |p: Vec3| half - sign * p[axis];
                let mut next = [Vec3::ZERO; 10];
                let mut kept = 0;
                for i in 0..count {
                    let (a, b) = (polygon[i], polygon[(i + 1) % count]);
                    let (da, db) = (inside(a), inside(b));
                    if da >= 0.0 && kept < 10 {
                        next[kept] = a;
                        kept += 1;
                    }
                    if (da >= 0.0) != (db >= 0.0) && kept < 10 {
                        next[kept] = a + (b - a) * (da / (da - db));
                        kept += 1;
                    }
                }
                polygon = next;
                count = kept;
            }
        }
        if count == 0 {
            return None;
        }
        let corners = &polygon[..count];
        let area: Vec3 = (1..count.max(2) - 1)
            .map(|i| (corners[i] - corners[0]).cross(corners[i + 1] - corners[0]))
            .sum();
        let middle = corners.iter().sum::<Vec3>() / count as f32;
        Some(Self {
            polygon,
            count,
            area: area.length(),
            middle,
        })
    }
}

/// Positions sorted into cells.
struct Cells {
    low: IVec3,
    dims: IVec3,
    /// Numbers of positions, cell after cell.
    order: Vec<usize>,
    /// Where each cell that is not empty starts in `order`.
    starts: Vec<usize>,
    /// By cell: its number in `starts`, or none.
    table: Vec<u32>,
}

impl Cells {
    fn new(positions: &[Vec3]) -> Self {
        let cell = |p: Vec3| (p / CELL).floor().as_ivec3();
        let zero = IVec3::ZERO;
        let low = positions
            .iter()
            .map(|p| cell(*p))
            .reduce(IVec3::min)
            .unwrap_or(zero);
        let high = positions
            .iter()
            .map(|p| cell(*p))
            .reduce(IVec3::max)
            .unwrap_or(zero - 1);
        let dims = high - low + 1;
        let at = |p: Vec3| {
            let c = cell(p) - low;
            (c.z as usize * dims.y as usize + c.y as usize) * dims.x as usize + c.x as usize
        };
        let mut order: Vec<usize> = (0..positions.len()).collect();
        order.sort_by_key(|&i| (at(positions[i]), scatter(i)));
        let mut table = vec![u32::MAX; dims.as_u64vec3().element_product() as usize];
        let mut starts = Vec::new();
        for (rank, &i) in order.iter().enumerate() {
            let slot = &mut table[at(positions[i])];
            if *slot == u32::MAX {
                *slot = starts.len() as u32;
                starts.push(rank);
            }
        }
        Self {
            low,
            dims,
            order,
            starts,
            table,
        }
    }

    fn members(&self, cell: IVec3) -> &[usize] {
        let c = cell - self.low;
        if c.cmplt(IVec3::ZERO).any() || c.cmpge(self.dims).any() {
            return &[];
        }
        let at = (c.z as usize * self.dims.y as usize + c.y as usize) * self.dims.x as usize
            + c.x as usize;
        match self.table[at] {
            u32::MAX => &[],
            n => {
                let end = self
                    .starts
                    .get(n as usize + 1)
                    .copied()
                    .unwrap_or(self.order.len());
                &self.order[self.starts[n as usize]..end]
            }
        }
    }
}

/// Where rays can start.
struct Eyes<'a> {
    positions: Vec<Vec3>,
    /// Camera axes of each eye, if its view is limited.
    views: Option<(&'a Camera, Vec<Mat3>)>,
    cells: Cells,
    /// Offsets of cells within range, the nearest first.
    rings: Vec<IVec3>,
    range: f32,
}

impl<'a> Eyes<'a> {
    fn new(sight: &Sight, camera: &'a Camera, range: f32) -> Self {
        let (positions, views) = match sight {
            Sight::Views(views) => (
                views.iter().map(|v| v.translation).collect(),
                Some((
                    camera,
                    views
                        .iter()
                        .map(|v| Mat3::from_quat(v.rotation).transpose())
                        .collect(),
                )),
            ),
            Sight::Positions(positions) => (positions.to_vec(), None),
        };
        let reach = ((range / CELL).ceil() as i32 + 1).min(24);
        let mut rings = Vec::new();
        for z in -reach..=reach {
            for y in -reach..=reach {
                for x in -reach..=reach {
                    rings.push(IVec3::new(x, y, z));
                }
            }
        }
        rings.retain(|c| c.length_squared() <= reach * reach);
        rings.sort_by_key(|c| c.length_squared());
        let mut cells = Cells::new(&positions);
        if views.is_some() {
            cells.order.sort_by_key(|&i| scatter(i));
        }
        Self {
            positions,
            views,
            cells,
            rings,
            range,
        }
    }

    /// Eyes that may see `point`; returns their number. Of limited views any, in a random but fixed order; of free
    /// positions near ones first, one of a cell.
    fn find(&self, point: Vec3, margin: f32, found: &mut [usize]) -> usize {
        let range = (self.range + margin).powi(2);
        let may_see = |eye: usize| {
            self.positions[eye].distance_squared(point) <= range && self.in_view(eye, point)
        };
        let mut count = 0;
        if self.views.is_some() {
            for &eye in self
                .cells
                .order
                .iter()
                .filter(|&&eye| may_see(eye))
                .take(found.len())
            {
                found[count] = eye;
                count += 1;
            }
            return count;
        }
        let home = (point / CELL).floor().as_ivec3();
        for ring in &self.rings {
            for &eye in self
                .cells
                .members(home + *ring)
                .iter()
                .filter(|&&eye| may_see(eye))
                .take(1)
            {
                found[count] = eye;
                count += 1;
                if count == found.len() {
                    return count;
                }
            }
        }
        count
    }

    /// First and last key of the voxels that can be in range of an eye.
    fn reach(&self, resolution: f64) -> (IVec3, IVec3) {
        let around = Aabb::of(self.positions.iter().copied()).grown(self.range);
        let key = |p: Vec3| (p.as_dvec3() / resolution).floor().as_ivec3();
        (key(around.min), key(around.max))
    }

    fn in_view(&self, eye: usize, point: Vec3) -> bool {
        let Some((camera, axes)) = &self.views else {
            return true;
        };
        let p = axes[eye] * (point - self.positions[eye]);
        let (u, v) = (
            p.x / p.z * camera.fx + camera.cx,
            p.y / p.z * camera.fy + camera.cy,
        );
        p.z > 0.0
            && (0.0..=camera.width as f32).contains(&u)
            && (0.0..=camera.height as f32).contains(&v)
    }
}

/// A number that looks random: neighbours in a list of eyes mostly see the same.
fn scatter(i: usize) -> u64 {
    (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15)
}

/// At most `count` of the numbers below `len`, evenly spread.
fn spread(len: usize, count: usize) -> impl Iterator<Item = usize> {
    let count = count.clamp(1, len.max(1)).min(len);
    (0..count).map(move |i| i * len / count)
}

#[cfg(test)]
mod tests;
