//! Whole numbers from Python, by the names of their arguments: pyo3 tells of a negative or too large one neither name nor value.
use pyo3::exceptions::{PyOverflowError, PyValueError};
use pyo3::prelude::*;

macro_rules! arguments {
    ($($name:ident: $kind:ty),* $(,)?) => {
        $(pub fn $name(value: &Bound<'_, PyAny>) -> PyResult<$kind> {
            told(stringify!($name), value, value.extract())
        })*
    };
}

// To be named in `#[pyo3(from_py_with = …)]`.
arguments! {
    count: usize,
    height: usize,
    num_envs: usize,
    num_threads: usize,
    seed: u64,
    stride: Option<usize>,
    width: usize,
}

fn told<T>(name: &str, value: &Bound<'_, PyAny>, number: PyResult<T>) -> PyResult<T> {
    number.map_err(|e| match e.is_instance_of::<PyOverflowError>(value.py()) {
        true => PyValueError::new_err(format!(
            "{name} must be a whole number from 0 to 2^64 - 1, got {value}"
        )),
        false => e,
    })
}
