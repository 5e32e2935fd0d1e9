//! Where rays can start, sorted so that those that may see a point are found quickly.
use super::Sight;
use crate::camera::Camera;
use crate::geometry::{Aabb, IVec3, Mat3, Vec3};

/// Cells that eyes are sorted into, metres.
const CELL: f32 = 0.8;

/// Positions sorted into cells.
pub struct Cells {
    low: IVec3,
    dims: IVec3,
    /// Numbers of positions, cell after cell.
    pub order: Vec<usize>,
    /// Where each cell that is not empty starts in `order`.
    pub starts: Vec<usize>,
    /// By cell: its number in `starts`, or none.
    table: Vec<u32>,
}

impl Cells {
    pub fn new(positions: &[Vec3]) -> Self {
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

    pub fn members(&self, cell: IVec3) -> &[usize] {
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
pub struct Eyes<'a> {
    pub positions: Vec<Vec3>,
    /// Camera axes of each eye, if its view is limited.
    views: Option<(&'a Camera, Vec<Mat3>)>,
    cells: Cells,
    /// Offsets of cells within range, the nearest first.
    rings: Vec<IVec3>,
    range: f32,
}

impl<'a> Eyes<'a> {
    pub fn new(sight: &Sight, camera: &'a Camera, range: f32) -> Self {
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
        let reach = (range / CELL).ceil().min(23.0) as i32 + 1;
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
        let cells = if views.is_some() {
            // Views are few and may lie far apart: a table of the cells between them could be of any size.
            let mut order: Vec<usize> = (0..positions.len()).collect();
            order.sort_by_key(|&i| scatter(i));
            Cells {
                order,
                ..Cells::new(&[])
            }
        } else {
            Cells::new(&positions)
        };
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
    pub fn find(&self, point: Vec3, margin: f32, found: &mut [usize]) -> usize {
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
    pub fn reach(&self, resolution: f64) -> (IVec3, IVec3) {
        let around = Aabb::of(self.positions.iter().copied()).grown(self.range);
        let key = |p: Vec3| (p.as_dvec3() / resolution).floor().as_ivec3();
        (key(around.min), key(around.max))
    }

    pub fn in_view(&self, eye: usize, point: Vec3) -> bool {
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
pub fn scatter(i: usize) -> u64 {
    (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15)
}
