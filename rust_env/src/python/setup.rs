//! `Camera` and `Setup`: the values that say what is simulated.
use super::arguments::{poses, Fields, Floats};
use super::bodies::bodies_spec;
use super::whole;
use crate::arm::Arm;
use crate::belief::integrate::Integration;
use crate::belief::octree::SensorModel;
use crate::belief::viewpoints::ViewSpace;
use crate::camera::{self, DepthKind};
use crate::robot::Robot;
use crate::setup::{self as core, LocalMap, MapSpec, SceneChoice, Truth};
use crate::world::lidar::Lidar;
use crate::world::noise::DepthNoise;
use numpy::{PyArray, PyArrayDyn, PyArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

#[pyclass(module = "nbv_gym.rust_env", frozen, from_py_object)]
#[derive(Clone)]
pub struct Camera(pub camera::Camera);

#[pymethods]
impl Camera {
    #[new]
    #[pyo3(signature = (width, height, hfov, vfov=None, near=0.0, far=4.0, kind="range"))]
    fn new(
        #[pyo3(from_py_with = whole::width)] width: usize,
        #[pyo3(from_py_with = whole::height)] height: usize,
        hfov: f64,
        vfov: Option<f64>,
        near: f64,
        far: f64,
        kind: &str,
    ) -> PyResult<Self> {
        let square = 2.0 * ((hfov / 2.0).tan() * height as f64 / (width as f64).max(1.0)).atan();
        let mut camera =
            camera::Camera::from_fov(width, height, hfov, vfov.unwrap_or(square), near, far)?;
        camera.kind = match kind {
            "range" => DepthKind::Range,
            "z" => DepthKind::Z,
            other => {
                return Err(PyValueError::new_err(format!(
                    "camera kind must be 'range' or 'z', got {other:?}"
                )))
            }
        };
        Ok(Self(camera))
    }
    #[getter]
    fn width(&self) -> usize {
        self.0.width
    }
    #[getter]
    fn height(&self) -> usize {
        self.0.height
    }
    #[getter]
    fn hfov(&self) -> f32 {
        self.0.hfov()
    }
    #[getter]
    fn vfov(&self) -> f32 {
        self.0.vfov()
    }
    #[getter]
    fn fx(&self) -> f32 {
        self.0.fx
    }
    #[getter]
    fn fy(&self) -> f32 {
        self.0.fy
    }
    #[getter]
    fn cx(&self) -> f32 {
        self.0.cx
    }
    #[getter]
    fn cy(&self) -> f32 {
        self.0.cy
    }
    #[getter]
    fn near(&self) -> f32 {
        self.0.near
    }
    #[getter]
    fn far(&self) -> f32 {
        self.0.far
    }
    #[getter]
    fn kind(&self) -> &'static str {
        match self.0.kind {
            DepthKind::Range => "range",
            DepthKind::Z => "z",
        }
    }

    /// World points of a depth image, (height, width, 3); NaN where nothing was measured.
    fn unproject<'py>(
        &self,
        py: Python<'py>,
        depth: Floats,
        pose: Floats,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let camera = &self.0;
        let pose = super::arguments::pose("pose", &pose)?;
        let image = self.image("depth", &depth)?;
        let mut out = Vec::with_capacity(image.len() * 3);
        for v in 0..camera.height {
            for u in 0..camera.width {
                let d = image[v * camera.width + u];
                let measured = d > 0.0 && d.is_finite();
                let p = camera.unproject(&pose, u, v, if measured { d } else { f32::NAN });
                out.extend(p.to_array());
            }
        }
        PyArray::from_vec(py, out).reshape(vec![camera.height, camera.width, 3])
    }

    fn __repr__(&self) -> String {
        let c = &self.0;
        format!(
            "Camera({}, {}, hfov={:.4}, vfov={:.4}, near={}, far={}, kind={:?})",
            c.width,
            c.height,
            c.hfov(),
            c.vfov(),
            c.near,
            c.far,
            self.kind()
        )
    }
    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<Self>().is_ok_and(|o| o.get().0 == self.0)
    }
    fn __hash__(&self) -> u64 {
        let c = &self.0;
        ((c.width as u64) << 32) ^ ((c.height as u64) << 16) ^ u64::from(c.fx.to_bits())
    }
    #[allow(clippy::type_complexity)]
    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, (Vec<f64>, &'static str))> {
        let c = &self.0;
        let numbers = [
            c.width as f64,
            c.height as f64,
            c.fx.into(),
            c.fy.into(),
            c.cx.into(),
            c.cy.into(),
            c.near.into(),
            c.far.into(),
        ];
        let rebuild = py.get_type::<Self>().getattr("_from_intrinsics")?;
        Ok((rebuild, (numbers.to_vec(), self.kind())))
    }
    #[staticmethod]
    fn _from_intrinsics(numbers: [f64; 8], kind: &str) -> PyResult<Self> {
        let [w, h, fx, fy, cx, cy, near, far] = numbers;
        let mut camera = Self::new(w as usize, h as usize, 1.0, Some(1.0), near, far, kind)?;
        for (name, v) in [("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)] {
            crate::error::positive(name, v)?;
        }
        camera.0.fx = fx as f32;
        camera.0.fy = fy as f32;
        camera.0.cx = cx as f32;
        camera.0.cy = cy as f32;
        Ok(camera)
    }
}

impl Camera {
    /// The values of an image of this camera's shape.
    pub fn image(&self, name: &str, array: &Floats) -> PyResult<Vec<f32>> {
        let view = array.as_array();
        if view.shape() != [self.0.height, self.0.width] {
            return Err(PyValueError::new_err(format!(
                "{name} must have the camera's shape ({}, {}), got {:?}",
                self.0.height,
                self.0.width,
                view.shape()
            )));
        }
        Ok(view.iter().copied().collect())
    }

    pub fn poses(&self, array: &Floats) -> PyResult<(Vec<crate::geometry::Pose>, Vec<usize>)> {
        let shape = array.as_array().shape().to_vec();
        Ok((poses("poses", array)?, shape[..shape.len() - 1].to_vec()))
    }
}

#[pyclass(module = "nbv_gym.rust_env", frozen)]
pub struct Setup(pub core::Setup);

#[pymethods]
impl Setup {
    #[new]
    #[pyo3(signature = (scene, camera, robot, map, views, local_map=None, noise=None, lidar=None, bodies=None, truth="sight"))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        scene: &Bound<'_, PyAny>,
        camera: Camera,
        robot: &Bound<'_, PyDict>,
        map: &Bound<'_, PyDict>,
        views: &Bound<'_, PyDict>,
        local_map: Option<&Bound<'_, PyDict>>,
        noise: Option<&Bound<'_, PyAny>>,
        lidar: Option<&Bound<'_, PyDict>>,
        bodies: Option<&Bound<'_, PyDict>>,
        truth: &str,
    ) -> PyResult<Self> {
        let scene = SceneChoice::parse(&scene.str()?.to_string())?;
        let map = map_spec(map, &camera)?;
        let local_map = local_map
            .map(|d| local_map_spec(d, map.resolution))
            .transpose()?;
        let setup = core::Setup {
            scene,
            camera: camera.0,
            robot: robot_spec(robot)?,
            map,
            views: view_space(views)?,
            local_map,
            noise: noise.map(depth_noise).transpose()?,
            lidar: lidar.map(lidar_spec).transpose()?,
            bodies: bodies.map(bodies_spec).transpose()?.unwrap_or_default(),
            truth: Truth::parse(truth)?,
        };
        Ok(Self(setup.checked()?))
    }
    #[getter]
    fn camera(&self) -> Camera {
        Camera(self.0.camera.clone())
    }
    #[getter]
    fn resolution(&self) -> f64 {
        self.0.map.resolution
    }
    #[getter]
    fn local_map_size(&self) -> usize {
        self.0.local_map.as_ref().map_or(0, |m| m.size)
    }
    #[getter]
    fn lidar_rays(&self) -> usize {
        self.0.lidar.as_ref().map_or(0, |l| l.rays)
    }
    #[getter]
    fn num_candidates(&self) -> usize {
        self.0.views.count()
    }
}

fn kind<'py>(owner: &'static str, dict: &Bound<'py, PyDict>) -> PyResult<(String, Fields<'py>)> {
    let fields = Fields::new(owner, dict)?;
    Ok((fields.require("kind")?, fields))
}

fn robot_spec(dict: &Bound<'_, PyDict>) -> PyResult<Robot> {
    let (kind, f) = kind("robot", dict)?;
    let flying = Robot::flying(
        f.get("radius", 0.1)?,
        f.get("speed", 0.5)?,
        f.get("turn_rate", 1.5)?,
    )?;
    let robot = match kind.as_str() {
        "flying" => flying,
        // The links of a UR5, the arm of Wang 2019.
        "arm" => flying.held_by(Arm::new(
            f.get("upper_arm", 0.425)?,
            f.get("forearm", 0.392)?,
            f.get("link_radius", 0.06)?,
        )?),
        other => {
            return Err(PyValueError::new_err(format!(
                "robot kind must be 'flying' or 'arm', got {other:?}"
            )))
        }
    };
    f.finish()?;
    Ok(robot)
}

pub fn sensor_model(f: &Fields) -> PyResult<SensorModel> {
    Ok(SensorModel::from_probabilities(
        f.get("hit", 0.7)?,
        f.get("miss", 0.4)?,
        f.get("clamp_min", 0.1192)?,
        f.get("clamp_max", 0.971)?,
    )?)
}

fn map_spec(dict: &Bound<'_, PyDict>, camera: &Camera) -> PyResult<MapSpec> {
    let f = Fields::new("map", dict)?;
    let resolution = f.require("resolution")?;
    let max_range = f.get("max_range", f64::from(camera.0.far))?;
    let mut spec = MapSpec::new(resolution, max_range, sensor_model(&f)?)?;
    spec.integration = Integration::parse(&f.get("integration", String::from("exact"))?)?;
    spec.view_history = f.get("view_history", false)?;
    f.finish()?;
    Ok(spec)
}

fn local_map_spec(dict: &Bound<'_, PyDict>, resolution: f64) -> PyResult<LocalMap> {
    let f = Fields::new("local_map", dict)?;
    let spec = LocalMap::new(f.get("size", 32)?, f.get("cell", resolution)?)?;
    f.finish()?;
    Ok(spec)
}

/// A preset's name, or a dictionary of a preset and what differs from it.
pub fn depth_noise(value: &Bound<'_, PyAny>) -> PyResult<DepthNoise> {
    if let Ok(name) = value.extract::<String>() {
        return Ok(DepthNoise::preset(&name)?);
    }
    let dict = value.cast::<PyDict>().map_err(|_| {
        PyTypeError::new_err(format!(
            "noise must be the name of a preset or a dictionary, got {value}"
        ))
    })?;
    let (kind, f) = kind("noise", dict)?;
    let preset = DepthNoise::preset(&kind)?;
    let noise = DepthNoise {
        constant: f.get("constant", preset.constant)?,
        growth: f.get("growth", preset.growth)?,
        nearest: f.get("nearest", preset.nearest)?,
        disparity_step: f.get("disparity_step", preset.disparity_step)?,
        focal_baseline: f.get("focal_baseline", preset.focal_baseline)?,
        max_incidence: f.get("max_incidence", preset.max_incidence)?,
        edge_incidence: f.get("edge_incidence", preset.edge_incidence)?,
    };
    f.finish()?;
    Ok(noise.checked()?)
}

fn lidar_spec(dict: &Bound<'_, PyDict>) -> PyResult<Lidar> {
    let f = Fields::new("lidar", dict)?;
    let lidar = Lidar::new(
        f.get("rays", 720)?,
        f.get("near", 0.0)?,
        f.require("range")?,
        f.get("mount", 0.0)?,
        f.get("sigma", 0.0)?,
    )?;
    f.finish()?;
    Ok(lidar)
}

fn view_space(dict: &Bound<'_, PyDict>) -> PyResult<ViewSpace> {
    let (kind, f) = kind("views", dict)?;
    let space = match kind.as_str() {
        "six_directions" => ViewSpace::six_directions(f.get("step", 0.3)?)?,
        "dome" => ViewSpace::dome(
            f.get("rings", 14)?,
            f.get("per_ring", 48)?,
            f.get("radius", 0.6)?,
            f.get("min_pitch", -35f64.to_radians())?,
            f.get("max_pitch", 60f64.to_radians())?,
        )?
        .with_reach(f.get("reach", 1)?)?,
        "ring" => ViewSpace::ring(
            f.get("positions", 10)?,
            f.get("radius", 0.6)?,
            f.get(
                "pitches",
                vec![15f64.to_radians(), 35f64.to_radians(), 55f64.to_radians()],
            )?,
        )?
        .with_reach(f.get("reach", 1)?)?,
        other => {
            return Err(PyValueError::new_err(format!(
                "views kind must be 'six_directions', 'dome' or 'ring', got {other:?}"
            )))
        }
    };
    f.finish()?;
    Ok(space)
}
