//! The one error type of the core. At the Python door `Invalid` becomes `ValueError`, `Io` becomes `OSError`.
use std::path::{Path, PathBuf};

#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A value that a caller passed; the message names the argument and the value.
    #[error("{0}")]
    Invalid(String),
    /// A fault of our own that was caught; at the door `nbv_gym.InternalError`.
    #[error("internal error: {0}")]
    Internal(String),
    /// The caller wanted the work to stop; at the door what Ctrl-C raises, `KeyboardInterrupt`.
    #[error("interrupted")]
    Interrupted,
    /// A file that cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
    /// A file that was read but whose content is broken; the message names what and where.
    #[error("{}: {message}", path.display())]
    Malformed { path: PathBuf, message: String },
}

pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    pub fn invalid(message: impl Into<String>) -> Self {
        Self::Invalid(message.into())
    }
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            source,
        }
    }
    pub fn malformed(path: &Path, message: impl Into<String>) -> Self {
        Self::Malformed {
            path: path.to_owned(),
            message: message.into(),
        }
    }
}

/// `value` if it is finite and positive, as an f32 too, else an error that names it.
pub fn positive(name: &str, value: f64) -> Result<f64> {
    if (value as f32).is_finite() && value as f32 > 0.0 {
        Ok(value)
    } else {
        Err(Error::invalid(format!(
            "{name} must be a finite number > 0 within f32's range, got {value:?}"
        )))
    }
}
