//! `Simulator`: n episodes stepped by Rust into NumPy buffers, in place and with the GIL released.
use super::arguments::{poses, Floats};
use super::belief::Belief;
use super::guarded;
use super::scene::{corners, vectors, Scene};
use super::setup::Setup;
use super::whole;
use crate::geometry::Pose;
use crate::metrics::METRICS;
use crate::simulator::{self as core, Buffers};
use crate::snapshot;
use numpy::{
    PyArray, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadwriteArrayDyn, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyKeyError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

#[pyclass(module = "nbv_gym.rust_env")]
pub struct Simulator(pub core::Simulator);

/// Viewpoints as an array (k, 7).
pub fn viewpoints<'py>(py: Python<'py>, views: &[Pose]) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let flat = views.iter().flat_map(|v| v.to_array()).collect();
    PyArray::from_vec(py, flat).reshape(vec![views.len(), 7])
}

/// The buffers of one call, borrowed from NumPy while the core writes into them.
#[derive(Default)]
struct Borrowed<'py> {
    depth: Option<PyReadwriteArrayDyn<'py, f32>>,
    scan: Option<PyReadwriteArrayDyn<'py, f32>>,
    pose: Option<PyReadwriteArrayDyn<'py, f32>>,
    local_map: Option<PyReadwriteArrayDyn<'py, f32>>,
    visited: Option<PyReadwriteArrayDyn<'py, f32>>,
    candidates: Option<PyReadwriteArrayDyn<'py, f32>>,
    mask: Option<PyReadwriteArrayDyn<'py, bool>>,
    metrics: Option<PyReadwriteArrayDyn<'py, f64>>,
}

fn borrow<'py, T: numpy::Element>(
    name: &str,
    value: &Bound<'py, PyAny>,
    shape: &[usize],
) -> PyResult<Option<PyReadwriteArrayDyn<'py, T>>> {
    let array = value.cast::<PyArrayDyn<T>>().map_err(|_| {
        PyTypeError::new_err(format!(
            "buffer {name:?} must be a numpy array of {}",
            std::any::type_name::<T>()
        ))
    })?;
    if array.shape() != shape || !array.is_c_contiguous() {
        return Err(PyValueError::new_err(format!(
            "buffer {name:?} must be C-contiguous with shape {shape:?}, got shape {:?}",
            array.shape()
        )));
    }
    let borrowed = array
        .try_readwrite()
        .map_err(|e| PyValueError::new_err(format!("buffer {name:?}: {e}")))?;
    Ok(Some(borrowed))
}

impl<'py> Borrowed<'py> {
    fn new(buffers: &Bound<'py, PyDict>, simulator: &core::Simulator) -> PyResult<Self> {
        let (n, k) = (simulator.num_envs(), simulator.num_candidates());
        let setup = simulator.setup();
        let (h, w) = (setup.camera.height, setup.camera.width);
        let mut b = Self::default();
        for (key, value) in buffers.iter() {
            let name: String = key.extract()?;
            match name.as_str() {
                "depth" => b.depth = borrow("depth", &value, &[n, h, w])?,
                "scan" => {
                    let Some(lidar) = &setup.lidar else {
                        return Err(PyValueError::new_err(
                            "buffer 'scan': the setup has no lidar",
                        ));
                    };
                    b.scan = borrow("scan", &value, &[n, lidar.rays])?;
                }
                "pose" => b.pose = borrow("pose", &value, &[n, 7])?,
                "local_map" => {
                    let Some(window) = &setup.local_map else {
                        return Err(PyValueError::new_err(
                            "buffer 'local_map': the setup has no local_map",
                        ));
                    };
                    let d = window.size;
                    b.local_map = borrow("local_map", &value, &[n, 3, d, d, d])?;
                }
                "visited" => b.visited = borrow("visited", &value, &[n, k])?,
                "candidates" => b.candidates = borrow("candidates", &value, &[n, k, 7])?,
                "mask" => b.mask = borrow("mask", &value, &[n, k])?,
                "metrics" => b.metrics = borrow("metrics", &value, &[n, METRICS.len()])?,
                other => return Err(PyKeyError::new_err(format!("there is no buffer {other:?}"))),
            }
        }
        Ok(b)
    }

    fn slices(&mut self) -> PyResult<Buffers<'_>> {
        Ok(Buffers {
            depth: self.depth.as_mut().map(|a| a.as_slice_mut()).transpose()?,
            scan: self.scan.as_mut().map(|a| a.as_slice_mut()).transpose()?,
            pose: self.pose.as_mut().map(|a| a.as_slice_mut()).transpose()?,
            local_map: self
                .local_map
                .as_mut()
                .map(|a| a.as_slice_mut())
                .transpose()?,
            visited: self
                .visited
                .as_mut()
                .map(|a| a.as_slice_mut())
                .transpose()?,
            candidates: self
                .candidates
                .as_mut()
                .map(|a| a.as_slice_mut())
                .transpose()?,
            mask: self.mask.as_mut().map(|a| a.as_slice_mut()).transpose()?,
            metrics: self
                .metrics
                .as_mut()
                .map(|a| a.as_slice_mut())
                .transpose()?,
        })
    }
}

fn flags(array: &PyReadonlyArray1<'_, bool>) -> Vec<bool> {
    array.as_array().iter().copied().collect()
}

#[pymethods]
impl Simulator {
    #[new]
    #[pyo3(signature = (setup, num_envs=1, num_threads=1))]
    fn new(
        setup: &Setup,
        #[pyo3(from_py_with = whole::num_envs)] num_envs: usize,
        #[pyo3(from_py_with = whole::num_threads)] num_threads: usize,
    ) -> PyResult<Self> {
        Ok(Self(core::Simulator::new(
            setup.0.clone(),
            num_envs,
            num_threads,
        )?))
    }

    fn reset(
        &mut self,
        py: Python<'_>,
        mask: PyReadonlyArray1<'_, bool>,
        seeds: Vec<Option<u64>>,
        buffers: &Bound<'_, PyDict>,
    ) -> PyResult<()> {
        let mask = flags(&mask);
        let mut borrowed = Borrowed::new(buffers, &self.0)?;
        let out = borrowed.slices()?;
        let simulator = &mut self.0;
        guarded(py, move || simulator.reset(&mask, &seeds, out))
    }

    fn step(
        &mut self,
        py: Python<'_>,
        commands: PyReadonlyArray2<'_, f32>,
        reset_mask: PyReadonlyArray1<'_, bool>,
        buffers: &Bound<'_, PyDict>,
    ) -> PyResult<()> {
        // A view of numbers that lie askew in memory would be undefined behaviour.
        if !commands.is_aligned() {
            return Err(PyValueError::new_err(
                "commands must be aligned in memory; copy them",
            ));
        }
        let view = commands.as_array();
        if view.shape() != [self.0.num_envs(), 7] {
            return Err(PyValueError::new_err(format!(
                "commands must have shape ({}, 7), got {:?}",
                self.0.num_envs(),
                view.shape()
            )));
        }
        let commands: Vec<[f32; 7]> = view
            .outer_iter()
            .map(|row| std::array::from_fn(|k| row[k]))
            .collect();
        let mask = flags(&reset_mask);
        let mut borrowed = Borrowed::new(buffers, &self.0)?;
        let out = borrowed.slices()?;
        let simulator = &mut self.0;
        guarded(py, move || simulator.step(&commands, &mask, out))
    }

    #[pyo3(signature = (notes=None))]
    fn save<'py>(&self, py: Python<'py>, notes: Option<&[u8]>) -> PyResult<Bound<'py, PyBytes>> {
        let simulator = &self.0;
        let bytes = guarded(py, || simulator.save(notes.unwrap_or_default()))?;
        Ok(PyBytes::new(py, &bytes))
    }

    fn load(
        &mut self,
        py: Python<'_>,
        snapshot: &[u8],
        buffers: &Bound<'_, PyDict>,
    ) -> PyResult<()> {
        let mut borrowed = Borrowed::new(buffers, &self.0)?;
        let out = borrowed.slices()?;
        let simulator = &mut self.0;
        guarded(py, move || simulator.load(snapshot, out))
    }

    #[staticmethod]
    fn read_notes<'py>(py: Python<'py>, snapshot: &[u8]) -> PyResult<Bound<'py, PyBytes>> {
        let notes = guarded(py, || Ok(snapshot::read(snapshot)?.notes.into_owned()))?;
        Ok(PyBytes::new(py, &notes))
    }

    fn belief(slf: Py<Self>, py: Python<'_>, i: usize) -> PyResult<Belief> {
        slf.bind(py).try_borrow()?.0.episode(i)?;
        Ok(Belief {
            simulator: slf,
            index: i,
        })
    }

    #[getter]
    fn num_envs(&self) -> usize {
        self.0.num_envs()
    }
    #[getter]
    fn num_candidates(&self) -> usize {
        self.0.num_candidates()
    }

    /// The truth of environment `i`.
    fn scene(&self, i: usize) -> PyResult<Scene> {
        Ok(Scene(self.0.episode(i)?.assets().clone()))
    }

    /// Poses of the bodies that move in environment `i`.
    fn body_poses<'py>(&self, py: Python<'py>, i: usize) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        viewpoints(py, &self.0.episode(i)?.world().bodies().poses())
    }

    /// Their triangles, as sensors see them.
    fn body_triangles<'py>(
        &self,
        py: Python<'py>,
        i: usize,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        corners(py, &self.0.episode(i)?.world().bodies().mesh())
    }

    fn true_gain<'py>(
        &mut self,
        py: Python<'py>,
        i: usize,
        poses: Floats,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let goals = self::poses("poses", &poses)?;
        let simulator = &mut self.0;
        let rows = guarded(py, || simulator.foresee(i, &goals))?;
        PyArray::from_vec(py, rows.concat()).reshape(vec![goals.len(), METRICS.len()])
    }

    fn true_contact<'py>(
        &self,
        py: Python<'py>,
        i: usize,
        poses: Floats,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let goals = self::poses("poses", &poses)?;
        let simulator = &self.0;
        let contacts = guarded(py, || simulator.foresee_contact(i, &goals))?;
        Ok(PyArray1::from_vec(py, contacts))
    }

    fn truth_surface<'py>(
        &self,
        py: Python<'py>,
        i: usize,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let episode = self.0.episode(i)?;
        let octree = episode.belief().octree();
        let centers: Vec<_> = episode
            .truth()
            .keys()
            .into_iter()
            .map(|k| octree.center(k))
            .collect();
        vectors(py, &centers)
    }

    /// Environment `i` panics at its next step or reset. For tests.
    fn _fail_next(&mut self, i: usize) -> PyResult<()> {
        Ok(self.0.fail_next(i)?)
    }

    fn timings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let d = PyDict::new(py);
        for (stage, seconds) in self.0.timings() {
            d.set_item(stage, seconds)?;
        }
        Ok(d)
    }
}
