//! `Scene`: the truth, for reports, viewers and measurement; agents never see it.
use super::arguments::{points, Floats};
use super::guarded;
use super::setup::{depth_noise, Camera};
use super::whole;
use crate::belief::octree::checked_resolution;
use crate::belief::ray_walk::unit;
use crate::world::bodies::Walker;
use crate::world::inspection::Visible;
use crate::world::noise::Disturbance;
use crate::world::scene_cache::SceneCache;
use crate::world::scenes::LoadOptions;
use crate::world::{SceneAssets, SceneSource};
use numpy::{PyArray, PyArray1, PyArrayDyn, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::Arc;

/// Largest number of depth values that one call may ask for (8 GiB of f32).
const MAX_VALUES: usize = 1 << 31;

type Counts<'py> = Bound<'py, PyArrayDyn<i64>>;

#[pyclass(module = "nbv_gym.rust_env", frozen)]
pub struct Scene(pub Arc<SceneAssets>);

pub fn corners<'py>(
    py: Python<'py>,
    mesh: &crate::geometry::Mesh,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let n = mesh.triangles.len();
    let flat = (0..n)
        .flat_map(|t| mesh.corners(t))
        .flat_map(|p| p.to_array())
        .collect();
    PyArray::from_vec(py, flat).reshape(vec![n, 3, 3])
}

pub fn vectors<'py>(
    py: Python<'py>,
    points: &[crate::geometry::Vec3],
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let flat = points.iter().flat_map(|p| p.to_array()).collect();
    PyArray::from_vec(py, flat).reshape(vec![points.len(), 3])
}

fn box_array<'py>(
    py: Python<'py>,
    b: &crate::geometry::Aabb,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    vectors(py, &[b.min, b.max])
}

#[pymethods]
impl Scene {
    #[staticmethod]
    #[pyo3(signature = (path, strict=false, search_paths=vec![], honour_up_axis=false))]
    fn load(
        py: Python<'_>,
        path: PathBuf,
        strict: bool,
        search_paths: Vec<PathBuf>,
        honour_up_axis: bool,
    ) -> PyResult<Self> {
        let options = LoadOptions {
            strict,
            search_paths,
            honour_up_axis,
            ..LoadOptions::default()
        };
        guarded(py, || Ok(Self(SceneAssets::load(&path, &options)?)))
    }

    #[staticmethod]
    #[pyo3(signature = (kind, seed=0))]
    fn generate(
        py: Python<'_>,
        kind: String,
        #[pyo3(from_py_with = whole::seed)] seed: u64,
    ) -> PyResult<Self> {
        guarded(py, || {
            Ok(Self(SceneAssets::open(&SceneSource::Generated {
                kind,
                seed,
            })?))
        })
    }

    /// The folder of the cache on disk, its entries and their bytes; None if it is switched off.
    #[staticmethod]
    fn cache_info(py: Python<'_>) -> PyResult<Option<(PathBuf, usize, u64)>> {
        guarded(py, || {
            let cache = SceneCache::of_environment();
            Ok(cache.map(|cache| {
                let (entries, bytes) = cache.size();
                (cache.folder().to_owned(), entries, bytes)
            }))
        })
    }

    /// Removes all entries and returns how many there were.
    #[staticmethod]
    fn clear_cache(py: Python<'_>) -> PyResult<usize> {
        guarded(py, || match SceneCache::of_environment() {
            None => Ok(0),
            Some(cache) => cache
                .clear()
                .map_err(|e| crate::Error::io(cache.folder(), e)),
        })
    }

    #[getter]
    fn name(&self) -> &str {
        &self.0.scene.name
    }
    #[getter]
    fn triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        corners(py, &self.0.scene.visual)
    }
    #[getter]
    fn objects<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        PyArray::from_slice(py, &self.0.scene.objects)
    }
    #[getter]
    fn collision_triangles<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        corners(py, &self.0.scene.collision)
    }
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        box_array(py, &self.0.scene.bounds)
    }
    #[getter]
    fn floor(&self) -> f32 {
        self.0.scene.floor
    }
    #[getter]
    fn starts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let starts = &self.0.starts;
        let flat = starts
            .iter()
            .flat_map(|(p, yaw)| [p.x, p.y, p.z, *yaw])
            .collect();
        PyArray::from_vec(py, flat).reshape(vec![starts.len(), 4])
    }
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (scene, r) = (&self.0.scene, &self.0.scene.report);
        let d = PyDict::new(py);
        d.set_item("visual_triangles_read", r.visual_triangles_read)?;
        d.set_item("visual_triangles", scene.visual.triangles.len())?;
        d.set_item("collision_triangles_read", r.collision_triangles_read)?;
        d.set_item("collision_triangles", scene.collision.triangles.len())?;
        d.set_item("instances", r.instances)?;
        d.set_item("warnings", &r.warnings)?;
        d.set_item("missing", &r.missing)?;
        for (name, b) in [
            ("visual_bounds", &r.visual_bounds),
            ("collision_bounds", &r.collision_bounds),
        ] {
            let bounds = (!b.is_empty()).then(|| [b.min.to_array(), b.max.to_array()]);
            d.set_item(name, bounds)?;
        }
        d.set_item("load_milliseconds", r.load_milliseconds)?;
        d.set_item("cache", &r.cache)?;
        Ok(d)
    }

    #[pyo3(signature = (camera, poses, noise=None, seed=0))]
    fn render_depth<'py>(
        &self,
        py: Python<'py>,
        camera: &Camera,
        poses: Floats,
        noise: Option<&Bound<'py, PyAny>>,
        #[pyo3(from_py_with = whole::seed)] seed: u64,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let (poses, mut shape) = camera.poses(&poses)?;
        let pixels = camera.0.pixels();
        if poses.len().saturating_mul(pixels) > MAX_VALUES {
            return Err(PyValueError::new_err(format!(
                "{} images of {pixels} pixels are too many at once",
                poses.len()
            )));
        }
        let noise = noise.map(depth_noise).transpose()?;
        let mut out = vec![0.0; poses.len() * pixels];
        guarded(py, || {
            let (mut disturbance, mut perfect) = (Disturbance::new(seed), Vec::new());
            for (pose, image) in poses.iter().zip(out.chunks_exact_mut(pixels)) {
                crate::interrupt::check()?;
                self.0.renderer.render(&camera.0, pose, image);
                if let Some(noise) = &noise {
                    let mut rng = disturbance.next_stream();
                    noise.apply(&camera.0, image, &mut perfect, &mut rng);
                }
            }
            Ok(())
        })?;
        shape.extend([camera.0.height, camera.0.width]);
        PyArray::from_vec(py, out).reshape(shape)
    }

    fn cast_rays<'py>(
        &self,
        py: Python<'py>,
        origins: Floats,
        directions: Floats,
        max_range: f32,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
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
        if max_range.is_nan() || max_range <= 0.0 {
            return Err(PyValueError::new_err(format!(
                "max_range must be > 0 m, got {max_range}"
            )));
        }
        let ranges = guarded(py, || {
            let mut ranges = Vec::with_capacity(origins.len());
            for (i, (o, d)) in origins.iter().zip(&directions).enumerate() {
                if i % 1024 == 0 {
                    crate::interrupt::check()?;
                }
                ranges.push(match unit(*d) {
                    Some(unit) if o.is_finite() => {
                        let found = self.0.renderer.cast(*o, unit, max_range);
                        found.unwrap_or(f32::INFINITY)
                    }
                    _ => f32::NAN,
                });
            }
            Ok(ranges)
        })?;
        Ok(PyArray::from_vec(py, ranges))
    }

    fn visible_voxels<'py>(
        &self,
        py: Python<'py>,
        camera: &Camera,
        poses: Floats,
        resolution: f64,
    ) -> PyResult<(Counts<'py>, Counts<'py>)> {
        let (poses, shape) = camera.poses(&poses)?;
        checked_resolution(resolution)?;
        let seen = guarded(py, || self.0.visible(&camera.0, &poses, resolution))?;
        let counts = |count: fn(&Visible) -> usize| {
            let values = seen.iter().map(|v| count(v) as i64).collect();
            PyArray::from_vec(py, values).reshape(shape.clone())
        };
        Ok((counts(|v| v.voxels)?, counts(|v| v.objects)?))
    }

    fn clearance<'py>(
        &self,
        py: Python<'py>,
        points: Floats,
        max_distance: f32,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let points = super::arguments::points("points", &points)?;
        if !max_distance.is_finite() || max_distance <= 0.0 {
            return Err(PyValueError::new_err(format!(
                "max_distance must be finite and > 0 m, got {max_distance}"
            )));
        }
        let distances = guarded(py, || {
            let mut distances = Vec::with_capacity(points.len());
            for (i, point) in points.iter().enumerate() {
                if i % 1024 == 0 {
                    crate::interrupt::check()?;
                }
                distances.push(match point.is_finite() {
                    true => self.0.shape.clearance(*point, max_distance),
                    false => f32::NAN,
                });
            }
            Ok(distances)
        })?;
        Ok(PyArray::from_vec(py, distances))
    }

    /// People that the file tells of, as walkers of a setup's bodies.
    #[getter]
    fn actors<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let actor = |walker: &Walker| {
            let d = PyDict::new(py);
            let path: Vec<[f32; 2]> = walker.path.iter().map(|p| p.to_array()).collect();
            d.set_item("path", path)?;
            d.set_item("loop", walker.round)?;
            d.set_item("speed", walker.speed)?;
            Ok(d)
        };
        self.0.scene.actors.iter().map(actor).collect()
    }

    /// Centres of the voxels that the visual surface touches within the bounds.
    fn surface_voxels<'py>(
        &self,
        py: Python<'py>,
        resolution: f64,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        crate::error::positive("resolution", resolution)?;
        let centres = guarded(py, || self.0.surface_voxels(resolution))?;
        vectors(py, &centres)
    }

    fn __repr__(&self) -> String {
        let scene = &self.0.scene;
        format!(
            "Scene({:?}, {} triangles)",
            scene.name,
            scene.visual.triangles.len()
        )
    }
}
