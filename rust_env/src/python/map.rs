//! `Octree`: the map on its own, or a live, read-only view of the map inside a simulator.
use super::arguments::{point, points, poses, Fields, Floats};
use super::guarded;
use super::scene::vectors;
use super::setup::{sensor_model, Camera};
use super::simulator::Simulator;
use super::whole;
use crate::belief::frontier::frontier_voxels;
use crate::belief::gain::{view_gain, Gain, RaySpacing};
use crate::belief::grid::OccupancyGrid;
use crate::belief::integrate::{Integration, Integrator};
use crate::belief::octree::{probability, Change, KeyBox, Octree as Map, State};
use crate::belief::uncertainty::UncertaintyModel;
use crate::belief::view_history::{AZIMUTHS, ELEVATIONS};
use crate::belief::{map_file, nbvmap};
use crate::geometry::{Aabb, Vec3};
use crate::interrupt;
use numpy::{PyArray, PyArray1, PyArrayDyn, PyArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::PathBuf;

enum Source {
    Own(Box<(Map, Integrator)>),
    Live(Py<Simulator>, usize),
}

#[pyclass(module = "nbv_gym.rust_env")]
pub struct Octree(Source);

impl Octree {
    pub fn live(simulator: Py<Simulator>, index: usize) -> Self {
        Self(Source::Live(simulator, index))
    }

    fn read_map<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Map) -> crate::Result<T> + Send,
    ) -> PyResult<T> {
        match &self.0 {
            Source::Own(own) => guarded(py, || work(&own.0)),
            Source::Live(simulator, i) => {
                let simulator = simulator.bind(py).try_borrow()?;
                let core = &simulator.0;
                guarded(py, || work(core.episode(*i)?.belief().octree()))
            }
        }
    }

    fn change<T: Send>(
        &mut self,
        py: Python<'_>,
        work: impl FnOnce(&mut Map, &mut Integrator) -> crate::Result<T> + Send,
    ) -> PyResult<T> {
        match &mut self.0 {
            Source::Own(own) => guarded(py, || work(&mut own.0, &mut own.1)),
            Source::Live(..) => Err(PyTypeError::new_err(
                "the map of a running environment is read-only",
            )),
        }
    }

    fn per_point<'py, T: numpy::Element + Send>(
        &self,
        py: Python<'py>,
        array: &Floats,
        value: impl Fn(&Map, Vec3) -> T + Send + Sync,
    ) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
        let shape = array.as_array().shape().to_vec();
        let points = points("points", array)?;
        let out = self.read_map(py, |map| {
            let mut values = Vec::with_capacity(points.len());
            for (i, p) in points.iter().enumerate() {
                if i % 4096 == 0 {
                    interrupt::check()?;
                }
                values.push(value(map, *p));
            }
            Ok(values)
        })?;
        PyArray::from_vec(py, out).reshape(&shape[..shape.len() - 1])
    }

    #[allow(clippy::type_complexity)]
    pub fn slice_in<'py>(
        &self,
        py: Python<'py>,
        z_min: f32,
        z_max: f32,
        bounds: Aabb,
    ) -> PyResult<(Bound<'py, PyArrayDyn<i8>>, (f32, f32))> {
        if !(z_min.is_finite() && z_max.is_finite() && z_min <= z_max) {
            return Err(PyValueError::new_err(format!(
                "z_min and z_max must be finite with z_min <= z_max, got {z_min}, {z_max}"
            )));
        }
        let grid = self.read_map(py, |map| OccupancyGrid::slice(map, z_min, z_max, &bounds))?;
        let cells: Vec<i8> = grid.cells().iter().map(|c| *c as i8).collect();
        let array = PyArray::from_vec(py, cells).reshape(vec![grid.height(), grid.width()])?;
        Ok((array, (grid.origin().x, grid.origin().y)))
    }

    fn centers<'py>(
        &self,
        py: Python<'py>,
        state: State,
        bounds: Option<Floats>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let bounds = bounds.map(|b| aabb("bounds", &b)).transpose()?;
        let centers: Vec<Vec3> = self.read_map(py, |map| {
            let keys = match (bounds, state, map.limits()) {
                (Some(b), ..) => map.keys_in(state, &KeyBox::centered_in(map, &b))?,
                (None, State::Unknown, Some(limits)) => map.keys_in(state, &limits)?,
                (None, State::Unknown, None) => {
                    return Err(crate::Error::invalid(
                        "unknown needs bounds: this map has no limits",
                    ))
                }
                (None, ..) => map.keys(state),
            };
            Ok(keys.into_iter().map(|k| map.center(k)).collect())
        })?;
        vectors(py, &centers)
    }
}

/// The state of a name.
fn state(name: &str) -> PyResult<State> {
    match name {
        "unknown" => Ok(State::Unknown),
        "free" => Ok(State::Free),
        "occupied" => Ok(State::Occupied),
        other => Err(PyValueError::new_err(format!(
            "state must be 'unknown', 'free' or 'occupied', got {other:?}"
        ))),
    }
}

/// Centres (n, 3), states before and after (n,).
type Changed<'py> = (
    Bound<'py, PyArrayDyn<f32>>,
    Bound<'py, PyArray1<i8>>,
    Bound<'py, PyArray1<i8>>,
);

fn aabb(name: &str, array: &Floats) -> PyResult<Aabb> {
    match points(name, array)?.as_slice() {
        [min, max] if min.is_finite() && max.is_finite() && min.cmple(*max).all() => {
            Ok(Aabb::new(*min, *max))
        }
        other => Err(PyValueError::new_err(format!(
            "{name} must have shape (2, 3), lower corner first, got {other:?}"
        ))),
    }
}

#[pymethods]
impl Octree {
    #[new]
    #[pyo3(signature = (resolution, *, view_history=false, **sensor))]
    fn new(
        py: Python<'_>,
        resolution: f64,
        view_history: bool,
        sensor: Option<Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let fields = Fields::new("Octree", &sensor.unwrap_or_else(|| PyDict::new(py)))?;
        let mut map = Map::new(resolution, sensor_model(&fields)?)?;
        fields.finish()?;
        if view_history {
            map = map.with_view_history();
        }
        Ok(Self(Source::Own(Box::new((map, Integrator::default())))))
    }

    #[pyo3(signature = (depth, camera, pose, max_range=None, integration="exact"))]
    #[allow(clippy::too_many_arguments)]
    fn insert_depth(
        &mut self,
        py: Python<'_>,
        depth: Floats,
        camera: &Camera,
        pose: Floats,
        max_range: Option<f64>,
        integration: &str,
    ) -> PyResult<()> {
        let image = camera.image("depth", &depth)?;
        let pose = super::arguments::pose("pose", &pose)?;
        let integration = Integration::parse(integration)?;
        if let Some(r) = max_range {
            crate::error::positive("max_range", r)?;
        }
        let model = UncertaintyModel::of_camera(&camera.0);
        self.change(py, |map, integrator| {
            let integrator = integrator.using(integration);
            integrator.insert_depth(map, &image, &camera.0, &pose, max_range, &model)
        })
    }

    /// Record what a camera sees from `pose` in the view history.
    #[pyo3(signature = (camera, pose, max_range=None))]
    fn record_view(
        &mut self,
        py: Python<'_>,
        camera: &Camera,
        pose: Floats,
        max_range: Option<f64>,
    ) -> PyResult<()> {
        let pose = super::arguments::pose("pose", &pose)?;
        let range = max_range.unwrap_or(f64::from(camera.0.far));
        crate::error::positive("max_range", range)?;
        self.change(py, |map, _| map.record_view(&camera.0, &pose, range as f32))
    }

    #[pyo3(signature = (points, origin, max_range=None, integration="exact"))]
    fn insert_points(
        &mut self,
        py: Python<'_>,
        points: Floats,
        origin: Floats,
        max_range: Option<f64>,
        integration: &str,
    ) -> PyResult<()> {
        let cloud = super::arguments::points("points", &points)?;
        let origin = point("origin", &origin)?;
        let integration = Integration::parse(integration)?;
        self.change(py, |map, integrator| {
            let integrator = integrator.using(integration);
            integrator.insert_points(map, cloud, origin, max_range)
        })
    }

    /// Read an `.nbvmap` file, or OctoMap's `.bt` or `.ot`.
    #[staticmethod]
    #[pyo3(signature = (path, **sensor))]
    fn read(py: Python<'_>, path: PathBuf, sensor: Option<Bound<'_, PyDict>>) -> PyResult<Self> {
        let sensor = match sensor {
            Some(dict) if !dict.is_empty() => {
                let fields = Fields::new("Octree.read", &dict)?;
                let sensor = sensor_model(&fields)?;
                fields.finish()?;
                Some(sensor)
            }
            _ => None,
        };
        let map = guarded(py, || map_file::read(&path, sensor))?;
        Ok(Self(Source::Own(Box::new((map, Integrator::default())))))
    }

    /// Write an `.nbvmap` (all layers), `.bt` (states) or `.ot` (log-odds) file, by the path's ending.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.read_map(py, |map| map_file::write(map, &path))
    }

    #[pyo3(signature = (bounds=None))]
    fn clear(&mut self, py: Python<'_>, bounds: Option<Floats>) -> PyResult<()> {
        let bounds = bounds.map(|b| aabb("bounds", &b)).transpose()?;
        self.change(py, |map, _| {
            match bounds {
                Some(b) => map.clear_box(&KeyBox::centered_in(map, &b)),
                None => map.clear(),
            }
            Ok(())
        })
    }

    #[pyo3(signature = (factor, forget_below=0.1, bounds=None))]
    fn decay(
        &mut self,
        py: Python<'_>,
        factor: f32,
        forget_below: f32,
        bounds: Option<Floats>,
    ) -> PyResult<()> {
        let bounds = bounds.map(|b| aabb("bounds", &b)).transpose()?;
        self.change(py, |map, _| {
            let voxels = bounds.map(|b| KeyBox::centered_in(map, &b));
            map.decay(factor, forget_below, voxels.as_ref())
        })
    }

    /// Centres, old and new states of the voxels that changed since the last call.
    fn changed<'py>(&mut self, py: Python<'py>) -> PyResult<Changed<'py>> {
        let (resolution, changes): (f64, Vec<Change>) = match &mut self.0 {
            Source::Own(own) => guarded(py, || Ok((own.0.resolution(), own.0.changed())))?,
            Source::Live(simulator, i) => {
                let mut simulator = simulator.bind(py).try_borrow_mut()?;
                let core = &mut simulator.0;
                let resolution = core.setup().map.resolution;
                guarded(py, || Ok((resolution, core.changed(*i)?)))?
            }
        };
        let center = |c: &Change| ((c.key.as_dvec3() + 0.5) * resolution).as_vec3();
        let centers: Vec<Vec3> = changes.iter().map(center).collect();
        let (before, after): (Vec<i8>, Vec<i8>) = changes
            .iter()
            .map(|c| (c.before as i8, c.after as i8))
            .unzip();
        Ok((
            vectors(py, &centers)?,
            PyArray::from_vec(py, before),
            PyArray::from_vec(py, after),
        ))
    }

    /// Centres (..., 3) of the voxels of a state that are nearest to points (..., 3), and their distances (...,).
    #[pyo3(signature = (points, state="occupied", max_range=f64::INFINITY))]
    #[allow(clippy::type_complexity)]
    fn nearest<'py>(
        &self,
        py: Python<'py>,
        points: Floats,
        state: &str,
        max_range: f64,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f32>>, Bound<'py, PyArrayDyn<f32>>)> {
        let shape = points.as_array().shape().to_vec();
        let points = self::points("points", &points)?;
        let state = self::state(state)?;
        if max_range.is_nan() || max_range <= 0.0 {
            return Err(PyValueError::new_err(format!(
                "max_range must be > 0 m, got {max_range}"
            )));
        }
        let found: Vec<(Vec3, f32)> = self.read_map(py, |map| {
            let nearest = |p: &Vec3| {
                let found = map.nearest(*p, state, max_range)?;
                Ok(found.map_or((Vec3::NAN, f32::INFINITY), |(key, distance)| {
                    (map.center(key), distance as f32)
                }))
            };
            points.iter().map(nearest).collect()
        })?;
        let (centers, distances): (Vec<Vec3>, Vec<f32>) = found.into_iter().unzip();
        Ok((
            vectors(py, &centers)?.reshape(shape.clone())?,
            PyArray::from_vec(py, distances).reshape(&shape[..shape.len() - 1])?,
        ))
    }

    /// How many voxels of a box are unknown, free and occupied.
    fn counts_in(&self, py: Python<'_>, bounds: Floats) -> PyResult<(u64, u64, u64)> {
        let bounds = aabb("bounds", &bounds)?;
        let [unknown, free, occupied] = self.read_map(py, |map| {
            Ok(map.counts_in(&KeyBox::centered_in(map, &bounds)))
        })?;
        Ok((unknown, free, occupied))
    }

    /// A map of its own with the same content; of an environment's map, too.
    fn copy(&self, py: Python<'_>) -> PyResult<Self> {
        let map = self.read_map(py, |map| Ok(map.clone()))?;
        Ok(Self(Source::Own(Box::new((map, Integrator::default())))))
    }
    fn __copy__(&self, py: Python<'_>) -> PyResult<Self> {
        self.copy(py)
    }
    fn __deepcopy__(&self, py: Python<'_>, _memo: &Bound<'_, PyAny>) -> PyResult<Self> {
        self.copy(py)
    }
    #[allow(clippy::type_complexity)]
    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        let bytes = self.read_map(py, |map| Ok(nbvmap::serialise(map)))?;
        let rebuild = py.get_type::<Self>().getattr("_from_bytes")?;
        Ok((rebuild, (PyBytes::new(py, &bytes),)))
    }
    /// The map in the bytes of an `.nbvmap` file.
    #[staticmethod]
    fn _from_bytes(py: Python<'_>, data: &[u8]) -> PyResult<Self> {
        let map = guarded(py, || {
            nbvmap::parse(data, None).map_err(crate::Error::Invalid)
        })?;
        Ok(Self(Source::Own(Box::new((map, Integrator::default())))))
    }

    #[pyo3(signature = (origins, directions, max_range, ignore_unknown=false))]
    #[allow(clippy::type_complexity)]
    fn cast_rays<'py>(
        &self,
        py: Python<'py>,
        origins: Floats,
        directions: Floats,
        max_range: f64,
        ignore_unknown: bool,
    ) -> PyResult<(Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<i8>>)> {
        let (origins, directions) = (
            points("origins", &origins)?,
            points("directions", &directions)?,
        );
        if origins.len() != directions.len() {
            return Err(PyValueError::new_err(format!(
                "{} origins for {} directions",
                origins.len(),
                directions.len()
            )));
        }
        crate::error::positive("max_range", max_range)?;
        let (ranges, states) = self.read_map(py, |map| {
            map.cast_rays(&origins, &directions, max_range, ignore_unknown)
        })?;
        let states: Vec<i8> = states.into_iter().map(|s| s as i8).collect();
        Ok((PyArray::from_vec(py, ranges), PyArray::from_vec(py, states)))
    }

    #[pyo3(signature = (poses, camera, metric="unknown_count", stride=None, max_range=None, num_threads=1, angle_step=None))]
    #[allow(clippy::too_many_arguments)]
    fn view_gain<'py>(
        &self,
        py: Python<'py>,
        poses: Floats,
        camera: &Camera,
        metric: &str,
        #[pyo3(from_py_with = whole::stride)] stride: Option<usize>,
        max_range: Option<f64>,
        #[pyo3(from_py_with = whole::num_threads)] num_threads: usize,
        angle_step: Option<f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let views = self::poses("poses", &poses)?;
        let (gain, rays) = (Gain::parse(metric)?, ray_spacing(stride, angle_step)?);
        let range = max_range.unwrap_or(f64::from(camera.0.far));
        crate::error::positive("max_range", range)?;
        let pool = crate::simulator::own_pool(num_threads)?;
        let gains = self.read_map(py, |map| {
            let (camera, range, pool) = (&camera.0, range as f32, pool.as_ref());
            view_gain(map, &views, camera, gain, rays, range, None, pool)
        })?;
        Ok(PyArray::from_vec(py, gains))
    }

    fn log_odds<'py>(
        &self,
        py: Python<'py>,
        points: Floats,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.per_point(py, &points, |map, p| {
            map.key(p).and_then(|k| map.log_odds(k)).unwrap_or(f32::NAN)
        })
    }
    /// Probability of occupancy; 0.5 where unknown.
    fn probability<'py>(
        &self,
        py: Python<'py>,
        points: Floats,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.per_point(py, &points, |map, p| {
            let log_odds = map.key(p).and_then(|k| map.log_odds(k));
            log_odds.map_or(0.5, |l| probability(l) as f32)
        })
    }
    fn classify<'py>(
        &self,
        py: Python<'py>,
        points: Floats,
    ) -> PyResult<Bound<'py, PyArrayDyn<i8>>> {
        self.per_point(py, &points, |map, p| {
            map.key(p).map_or(State::Unknown, |k| map.state(k)) as i8
        })
    }
    fn uncertainty<'py>(
        &self,
        py: Python<'py>,
        points: Floats,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.per_point(py, &points, |map, p| {
            map.key(p).map_or(1.0, |k| map.uncertainty(k))
        })
    }
    #[pyo3(signature = (bounds=None))]
    fn occupied<'py>(
        &self,
        py: Python<'py>,
        bounds: Option<Floats>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.centers(py, State::Occupied, bounds)
    }
    #[pyo3(signature = (bounds=None))]
    fn free<'py>(
        &self,
        py: Python<'py>,
        bounds: Option<Floats>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.centers(py, State::Free, bounds)
    }
    #[pyo3(signature = (bounds=None))]
    fn unknown<'py>(
        &self,
        py: Python<'py>,
        bounds: Option<Floats>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        self.centers(py, State::Unknown, bounds)
    }
    fn occupied_uncertainty<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let values = self.read_map(py, |map| {
            Ok(map
                .keys(State::Occupied)
                .into_iter()
                .map(|k| map.uncertainty(k))
                .collect::<Vec<f32>>())
        })?;
        Ok(PyArray::from_vec(py, values))
    }
    fn frontiers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let centers: Vec<Vec3> = self.read_map(py, |map| {
            Ok(frontier_voxels(map, None)
                .into_iter()
                .map(|k| map.center(k))
                .collect())
        })?;
        vectors(py, &centers)
    }

    /// 2-D slice: (rows y, columns x) int8 and the lower-left corner (x, y) in metres.
    #[pyo3(signature = (z_min, z_max, bounds=None))]
    #[allow(clippy::type_complexity)]
    fn slice<'py>(
        &self,
        py: Python<'py>,
        z_min: f32,
        z_max: f32,
        bounds: Option<Floats>,
    ) -> PyResult<(Bound<'py, PyArrayDyn<i8>>, (f32, f32))> {
        let bounds = match bounds {
            Some(b) => aabb("bounds", &b)?,
            None => self.read_map(py, |map| Ok(map.bounds()))?,
        };
        self.slice_in(py, z_min, z_max, bounds)
    }

    /// From where the voxels at some points were seen: O_k and C_k, (..., 36, 18) each.
    #[allow(clippy::type_complexity)]
    fn view_history<'py>(
        &self,
        py: Python<'py>,
        points: Floats,
    ) -> PyResult<(Bound<'py, PyArrayDyn<f32>>, Bound<'py, PyArrayDyn<f32>>)> {
        let mut shape = points.as_array().shape().to_vec();
        let points = super::arguments::points("points", &points)?;
        const MAX_POINTS: usize = 1 << 16;
        if points.len() > MAX_POINTS {
            return Err(PyValueError::new_err(format!(
                "view_history takes at most {MAX_POINTS} points at once, got {}",
                points.len()
            )));
        }
        let (probability, confidence) = self.read_map(py, |map| map.view_history_at(&points))?;
        shape.pop();
        shape.extend([AZIMUTHS, ELEVATIONS]);
        Ok((
            PyArray::from_vec(py, probability).reshape(shape.clone())?,
            PyArray::from_vec(py, confidence).reshape(shape)?,
        ))
    }

    fn information(&self, py: Python<'_>) -> PyResult<f64> {
        self.read_map(py, |map| Ok(map.information()))
    }
    fn entropy(&self, py: Python<'_>) -> PyResult<f64> {
        self.read_map(py, |map| Ok(map.entropy()))
    }
    fn memory_bytes(&self, py: Python<'_>) -> PyResult<usize> {
        self.read_map(py, |map| Ok(map.memory_bytes()))
    }
    #[getter]
    fn num_known(&self, py: Python<'_>) -> PyResult<u64> {
        self.read_map(py, |map| Ok(map.num_known()))
    }
    #[getter]
    fn num_occupied(&self, py: Python<'_>) -> PyResult<u64> {
        self.read_map(py, |map| Ok(map.num_occupied()))
    }
    #[getter]
    fn resolution(&self, py: Python<'_>) -> PyResult<f64> {
        self.read_map(py, |map| Ok(map.resolution()))
    }
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let b = self.read_map(py, |map| Ok(map.bounds()))?;
        vectors(py, &[b.min, b.max])
    }
    /// The counts, counted again voxel by voxel: (known, occupied, entropy in bits, information). For tests.
    fn recount(&self, py: Python<'_>) -> PyResult<(u64, u64, f64, f64)> {
        self.read_map(py, |map| Ok(map.recount()))
    }
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        self.read_map(py, |map| {
            Ok(format!(
                "Octree(resolution={}, {} known voxels, {} occupied)",
                map.resolution(),
                map.num_known(),
                map.num_occupied()
            ))
        })
    }
}

/// How rays are spread: a stride in pixels (1 if nothing is said) or a step in radians.
pub fn ray_spacing(stride: Option<usize>, angle_step: Option<f64>) -> PyResult<RaySpacing> {
    match (stride, angle_step) {
        (Some(_), Some(_)) => Err(PyValueError::new_err(
            "rays are spread by stride or by angle_step, not by both",
        )),
        (Some(0), _) => Err(PyValueError::new_err(
            "stride must be at least 1 pixel, got 0",
        )),
        (_, Some(step)) => Ok(RaySpacing::AngleStep(step as f32)),
        (stride, None) => Ok(RaySpacing::Stride(stride.unwrap_or(1))),
    }
}
