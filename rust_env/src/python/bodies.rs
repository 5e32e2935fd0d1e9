//! The keyword `bodies` of a `Setup`: walkers and boxes, given or drawn.
use super::arguments::Fields;
use crate::geometry::{Vec2, Vec3};
use crate::world::bodies::{
    BodiesSpec, GivenBox, PushedBox, Walker, DENSITY, HEIGHT, RADIUS, SPEED,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A number of bodies to draw, or each of them.
#[derive(FromPyObject)]
enum Wanted<'py> {
    Number(usize),
    Each(Vec<Bound<'py, PyDict>>),
}

pub fn bodies_spec(dict: &Bound<'_, PyDict>) -> PyResult<BodiesSpec> {
    let f = Fields::new("bodies", dict)?;
    let mut spec = BodiesSpec {
        actors: f.get("actors", false)?,
        ..BodiesSpec::default()
    };
    match f.get("walkers", Wanted::Number(0))? {
        Wanted::Number(n) => spec.drawn_walkers = n,
        Wanted::Each(each) => {
            spec.walkers = each.iter().map(walker).collect::<PyResult<_>>()?;
        }
    }
    match f.get("boxes", Wanted::Number(0))? {
        Wanted::Number(n) => spec.drawn_boxes = n,
        Wanted::Each(each) => spec.boxes = each.iter().map(given_box).collect::<PyResult<_>>()?,
    }
    f.finish()?;
    Ok(spec.checked()?)
}

fn walker(dict: &Bound<'_, PyDict>) -> PyResult<Walker> {
    let f = Fields::new("walker", dict)?;
    let path: Vec<[f32; 2]> = f.require("path")?;
    let walker = Walker::new(
        path.into_iter().map(Vec2::from_array).collect(),
        f.get("loop", false)?,
        f.get("speed", f64::from(SPEED))?,
        f.get("radius", f64::from(RADIUS))?,
        f.get("height", f64::from(HEIGHT))?,
    )?;
    f.finish()?;
    Ok(walker)
}

fn given_box(dict: &Bound<'_, PyDict>) -> PyResult<GivenBox> {
    let f = Fields::new("box", dict)?;
    let position: Vec<f32> = f.require("position")?;
    let size: [f32; 3] = f.require("size")?;
    let (centre, on_floor) = match position[..] {
        [x, y] => (Vec3::new(x, y, 0.0), true),
        [x, y, z] => (Vec3::new(x, y, z), false),
        _ => {
            return Err(PyValueError::new_err(format!(
            "box position must be (x, y), on the floor, or the centre (x, y, z), got {position:?}"
        )))
        }
    };
    let (density, yaw) = (f.get("density", f64::from(DENSITY))?, f.get("yaw", 0.0)?);
    let pushed = PushedBox::new(Vec3::from_array(size), density, centre, yaw)?;
    f.finish()?;
    Ok(GivenBox { pushed, on_floor })
}
