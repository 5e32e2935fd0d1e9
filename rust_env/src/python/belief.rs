//! `Belief`: what a planner may see of one environment; a live, read-only view.
use super::arguments::{pose, poses, Floats};
use super::guarded;
use super::map::{ray_spacing, Octree};
use super::scene::vectors;
use super::setup::Camera;
use super::simulator::{viewpoints, Simulator};
use super::whole;
use crate::belief::gain::Gain;
use crate::belief::Belief as Core;
use crate::geometry::Vec3;
use numpy::{PyArray, PyArray1, PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use rand::SeedableRng;

#[pyclass(module = "nbv_gym.rust_env", frozen)]
pub struct Belief {
    pub simulator: Py<Simulator>,
    pub index: usize,
}

/// More samples than this are a mistake.
const MAX_SAMPLES: usize = 1_000_000;

impl Belief {
    fn read<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&Core) -> crate::Result<T> + Send,
    ) -> PyResult<T> {
        let simulator = self.simulator.bind(py).try_borrow()?;
        let core = &simulator.0;
        guarded(py, || work(core.episode(self.index)?.belief()))
    }
}

fn positions(views: &[crate::geometry::Pose]) -> Vec<Vec3> {
    views.iter().map(|v| v.translation).collect()
}

#[pymethods]
impl Belief {
    #[getter]
    fn octree(&self, py: Python<'_>) -> Octree {
        Octree::live(self.simulator.clone_ref(py), self.index)
    }
    #[getter]
    fn pose<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f32>>> {
        Ok(PyArray::from_slice(
            py,
            &self.read(py, |b| Ok(b.pose().to_array()))?,
        ))
    }
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let b = self.read(py, |b| Ok(*b.bounds()))?;
        vectors(py, &[b.min, b.max])
    }
    #[getter]
    fn camera(&self, py: Python<'_>) -> PyResult<Camera> {
        self.read(py, |b| Ok(b.camera().clone())).map(Camera)
    }
    #[getter]
    fn resolution(&self, py: Python<'_>) -> PyResult<f64> {
        self.read(py, |b| Ok(b.octree().resolution()))
    }
    #[getter]
    fn candidates<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        viewpoints(py, &self.read(py, |b| Ok(b.candidates().to_vec()))?)
    }
    #[getter]
    fn candidate_mask<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let mask: Vec<bool> = self.read(py, |b| {
            let mut mask = vec![false; b.candidates().len()];
            b.mask(&mut mask);
            Ok(mask)
        })?;
        Ok(PyArray::from_vec(py, mask))
    }
    #[getter]
    fn visited<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<u16>>> {
        Ok(PyArray::from_vec(
            py,
            self.read(py, |b| Ok(b.visited().to_vec()))?,
        ))
    }
    /// Indices of the candidates next to the one where the camera is.
    fn neighbours<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let near = self.read(py, |b| Ok(b.neighbours()))?;
        Ok(PyArray::from_vec(
            py,
            near.into_iter().map(|i| i as i64).collect(),
        ))
    }
    /// The last depth image.
    #[getter]
    fn depth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let simulator = self.simulator.bind(py).try_borrow()?;
        let episode = simulator.0.episode(self.index)?;
        let camera = episode.belief().camera();
        let image = PyArray::from_slice(py, episode.image());
        image.reshape(vec![camera.height, camera.width])
    }
    #[getter]
    fn trajectory<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        viewpoints(py, &self.read(py, |b| Ok(b.trajectory().to_vec()))?)
    }

    #[pyo3(signature = (poses, metric="unknown_count", stride=None, angle_step=None))]
    fn view_gain<'py>(
        &self,
        py: Python<'py>,
        poses: Floats,
        metric: &str,
        #[pyo3(from_py_with = whole::stride)] stride: Option<usize>,
        angle_step: Option<f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let views = self::poses("poses", &poses)?;
        let (gain, rays) = (Gain::parse(metric)?, ray_spacing(stride, angle_step)?);
        let mut simulator = self.simulator.bind(py).try_borrow_mut()?;
        let core = &mut simulator.0;
        let gains = guarded(py, || core.view_gain(self.index, &views, gain, rays))?;
        Ok(PyArray::from_vec(py, gains))
    }
    fn travel_cost<'py>(
        &self,
        py: Python<'py>,
        poses: Floats,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let goals = positions(&self::poses("poses", &poses)?);
        Ok(PyArray::from_vec(
            py,
            self.read(py, |b| Ok(b.travel_costs(&goals)))?,
        ))
    }
    fn reachable<'py>(
        &self,
        py: Python<'py>,
        poses: Floats,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let goals = positions(&self::poses("poses", &poses)?);
        Ok(PyArray::from_vec(
            py,
            self.read(py, |b| Ok(b.reachable(&goals)))?,
        ))
    }
    fn path_to<'py>(&self, py: Python<'py>, pose: Floats) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let goal = self::pose("pose", &pose)?;
        vectors(py, &self.read(py, |b| Ok(b.plan(&goal)))?)
    }
    fn frontiers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        vectors(py, &self.read(py, |b| Ok(b.frontiers()))?)
    }
    #[pyo3(signature = (z_min, z_max))]
    #[allow(clippy::type_complexity)]
    fn slice<'py>(
        &self,
        py: Python<'py>,
        z_min: f32,
        z_max: f32,
    ) -> PyResult<(Bound<'py, PyArrayDyn<i8>>, (f32, f32))> {
        let b = self.read(py, |b| Ok(*b.bounds()))?;
        self.octree(py).slice_in(py, z_min, z_max, b)
    }
    fn sample_free<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = whole::count)] count: usize,
        #[pyo3(from_py_with = whole::seed)] seed: u64,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        if count > MAX_SAMPLES {
            return Err(pyo3::exceptions::PyValueError::new_err(format!(
                "count must be at most {MAX_SAMPLES}, got {count}"
            )));
        }
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        viewpoints(py, &self.read(py, |b| Ok(b.sample_free(count, &mut rng)))?)
    }
}
