//! Reading Python arguments: arrays of the right shape, keyword dictionaries without unknown keys.
use crate::geometry::{Pose, Vec3};
use numpy::{
    PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Any array-like of real numbers; converted to float32, whatever its layout. Booleans, complex numbers, texts and
/// objects are refused: NumPy would make numbers of them.
pub struct Floats<'py>(PyReadonlyArrayDyn<'py, f32>);

/// More numbers in one argument are a mistake; an array of few numbers may be broadcast to any size.
const MAX_NUMBERS: usize = 1 << 28;
const MAX_DIMENSIONS: usize = 16;

impl<'py> std::ops::Deref for Floats<'py> {
    type Target = PyReadonlyArrayDyn<'py, f32>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl<'a, 'py> FromPyObject<'a, 'py> for Floats<'py> {
    type Error = PyErr;

    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        let py = object.py();
        let array = match object.cast::<PyUntypedArray>() {
            Ok(array) => array.to_owned(),
            Err(_) => {
                let numpy = py.import(intern!(py, "numpy"))?;
                let array = numpy.call_method1(intern!(py, "asarray"), (object,))?;
                array.cast_into::<PyUntypedArray>()?
            }
        };
        let dtype = array.dtype();
        if !matches!(dtype.kind(), b'f' | b'i' | b'u') {
            return Err(PyTypeError::new_err(format!(
                "expected an array of real numbers, got dtype {dtype}"
            )));
        }
        if array.ndim() > MAX_DIMENSIONS || array.len() > MAX_NUMBERS {
            return Err(PyValueError::new_err(format!(
                "an array of {} numbers in {} dimensions is too large, at most {MAX_NUMBERS} in {MAX_DIMENSIONS} are read",
                array.len(),
                array.ndim()
            )));
        }
        let fits = |a: &Bound<'py, PyArrayDyn<f32>>| a.is_aligned();
        let floats = match array.cast::<PyArrayDyn<f32>>() {
            Ok(floats) if fits(floats) => floats.clone(),
            // A new array, in C order, aligned, of this machine's byte order.
            _ => {
                let copy = array.call_method1(intern!(py, "astype"), ("float32", "C"))?;
                copy.cast_into::<PyArrayDyn<f32>>()?
            }
        };
        let readable = floats.try_readonly();
        readable
            .map(Self)
            .map_err(|e| PyValueError::new_err(format!("the array is in use: {e}")))
    }
}

/// Rows of `N` numbers from an array of shape (..., N), each as `make` makes it.
fn rows<const N: usize, T>(
    name: &str,
    array: &Floats,
    make: impl Fn([f32; N]) -> T,
) -> PyResult<Vec<T>> {
    let view = array.as_array();
    let shape = view.shape();
    if shape.last() != Some(&N) {
        return Err(PyValueError::new_err(format!(
            "{name} must have shape (..., {N}), got {shape:?}"
        )));
    }
    let strewn: Vec<f32>;
    let flat = match view.as_slice() {
        Some(slice) => slice,
        None => {
            strewn = view.iter().copied().collect();
            &strewn
        }
    };
    let (rows, _) = flat.as_chunks::<N>();
    Ok(rows.iter().map(|row| make(*row)).collect())
}

/// Points of shape (..., 3); they may be non-finite.
pub fn points(name: &str, array: &Floats) -> PyResult<Vec<Vec3>> {
    rows(name, array, Vec3::from_array)
}

/// One point of shape (3,), finite.
pub fn point(name: &str, array: &Floats) -> PyResult<Vec3> {
    match points(name, array)?.as_slice() {
        [p] if p.is_finite() => Ok(*p),
        [p] => Err(PyValueError::new_err(format!(
            "{name} must be finite, got {p}"
        ))),
        many => Err(PyValueError::new_err(format!(
            "{name} must be one point of shape (3,), got {} points",
            many.len()
        ))),
    }
}

/// Viewpoints of shape (..., 7).
pub fn poses(name: &str, array: &Floats) -> PyResult<Vec<Pose>> {
    let rows = rows(name, array, |row: [f32; 7]| row)?;
    let pose = |(i, row)| {
        Pose::from_array(row).map_err(|e| PyValueError::new_err(format!("{name}[{i}]: {e}")))
    };
    rows.into_iter().enumerate().map(pose).collect()
}

/// One viewpoint of shape (7,).
pub fn pose(name: &str, array: &Floats) -> PyResult<Pose> {
    match poses(name, array)?.as_slice() {
        [p] => Ok(*p),
        many => Err(PyValueError::new_err(format!(
            "{name} must have shape (7,), got {} viewpoints",
            many.len()
        ))),
    }
}

/// The keywords of a dictionary; what was not asked for is an error.
pub struct Fields<'py> {
    owner: &'static str,
    dict: Bound<'py, PyDict>,
}

impl<'py> Fields<'py> {
    pub fn new(owner: &'static str, dict: &Bound<'py, PyDict>) -> PyResult<Self> {
        Ok(Self {
            owner,
            dict: dict.copy()?,
        })
    }

    pub fn get<T>(&self, name: &str, default: T) -> PyResult<T>
    where
        T: for<'a> FromPyObject<'a, 'py>,
    {
        Ok(self.optional(name)?.unwrap_or(default))
    }

    pub fn require<T>(&self, name: &str) -> PyResult<T>
    where
        T: for<'a> FromPyObject<'a, 'py>,
    {
        self.optional(name)?
            .ok_or_else(|| PyTypeError::new_err(format!("{} needs {name:?}", self.owner)))
    }

    fn optional<T>(&self, name: &str) -> PyResult<Option<T>>
    where
        T: for<'a> FromPyObject<'a, 'py>,
    {
        let Some(value) = self.dict.get_item(name)? else {
            return Ok(None);
        };
        self.dict.del_item(name)?;
        let read: Result<T, PyErr> = value.extract::<T>().map_err(Into::into);
        read.map(Some)
            .map_err(|e| PyTypeError::new_err(format!("{} {name} = {value}: {e}", self.owner)))
    }

    pub fn finish(self) -> PyResult<()> {
        if self.dict.is_empty() {
            return Ok(());
        }
        let names: Vec<String> = self.dict.keys().iter().map(|k| k.to_string()).collect();
        Err(PyTypeError::new_err(format!(
            "{} does not know {}",
            self.owner,
            names.join(", ")
        )))
    }
}
