//! The door: the only place that names pyo3 or numpy. Arguments are checked here, the GIL is released while the core
//! works, a core error becomes `ValueError` or `OSError`, and a panic becomes `InternalError`.
mod arguments;
mod belief;
mod bodies;
mod map;
mod scene;
mod setup;
mod simulator;
mod whole;

use crate::error::Error;
use pyo3::create_exception;
use pyo3::exceptions::{PyKeyboardInterrupt, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use std::cell::RefCell;

create_exception!(
    nbv_gym.rust_env.nbv_core,
    InternalError,
    PyRuntimeError,
    "A fault of nbv-gym's own that was caught at the edge. The environment concerned must be reset."
);

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        match &error {
            Error::Invalid(_) | Error::Malformed { .. } => PyValueError::new_err(error.to_string()),
            Error::Internal(_) => InternalError::new_err(error.to_string()),
            Error::Interrupted => RAISED
                .with(RefCell::take)
                .unwrap_or_else(|| PyKeyboardInterrupt::new_err(())),
            Error::Io { path, source } => match source.raw_os_error() {
                // With an errno Python makes the right subclass, e.g. FileNotFoundError.
                Some(code) => {
                    PyOSError::new_err((code, source.to_string(), path.display().to_string()))
                }
                None if source.kind() == std::io::ErrorKind::NotFound => {
                    pyo3::exceptions::PyFileNotFoundError::new_err(error.to_string())
                }
                None => PyOSError::new_err(error.to_string()),
            },
        }
    }
}

thread_local! {
    /// What Python's signal handler raised when the core asked whether to go on.
    static RAISED: RefCell<Option<PyErr>> = const { RefCell::new(None) };
}

/// Python runs its signal handlers only when asked to, and only on the main thread.
fn signalled() -> bool {
    match Python::attach(|py| py.check_signals()) {
        Ok(()) => false,
        Err(raised) => {
            RAISED.with(|r| r.replace(Some(raised)));
            true
        }
    }
}

/// Run core code with the GIL released; a panic becomes an `InternalError`, and Ctrl-C stops long work.
fn guarded<T: Send>(py: Python<'_>, work: impl FnOnce() -> crate::Result<T> + Send) -> PyResult<T> {
    let outcome = py.detach(|| crate::fault::caught(|| crate::interrupt::watched(work)));
    Ok(outcome.unwrap_or_else(|what| Err(Error::Internal(what)))?)
}

#[pymodule(gil_used = true)]
mod nbv_core {
    #[pymodule_export]
    use super::belief::Belief;
    #[pymodule_export]
    use super::map::Octree;
    #[pymodule_export]
    use super::scene::Scene;
    #[pymodule_export]
    use super::setup::{Camera, Setup};
    #[pymodule_export]
    use super::simulator::Simulator;
    #[pymodule_export]
    use super::InternalError;
    use super::*;

    #[pymodule_init]
    fn init(m: &Bound<'_, PyModule>) -> PyResult<()> {
        crate::interrupt::ask_with(signalled);
        m.add("METRICS", crate::metrics::METRICS.to_vec())?;
        m.add("STAGES", crate::episode::STAGES.to_vec())?;
        m.add("GAINS", crate::belief::gain::NAMES.to_vec())?;
        m.add("NOISES", crate::world::noise::PRESETS.to_vec())?;
        m.add("SCENE_KINDS", crate::world::scenes::KINDS.to_vec())?;
        let kernels = [
            format!("render-{:?}", crate::world::render::Isa::best()),
            format!("map-{:?}", crate::belief::lockstep::Lanes::best()),
        ];
        m.add("KERNELS", kernels.map(|k| k.to_lowercase()).to_vec())?;
        m.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
