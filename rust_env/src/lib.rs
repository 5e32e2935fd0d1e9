//! nbv_core: the simulated half of nbv-gym.
//!
//! Two wings on common ground: [`world`] is *what is*, [`belief`] is *what the robot knows*; they never
//! import each other. [`episode`] is the only place where both meet, [`simulator`] runs many episodes at once.
pub mod arm;
pub mod belief;
pub mod camera;
pub mod capsule;
pub mod episode;
pub mod error;
pub mod fault;
pub mod geometry;
pub mod instructions;
pub mod interrupt;
pub mod metrics;
#[cfg(feature = "python")]
mod python;
pub mod robot;
pub mod setup;
pub mod simulator;
pub mod snapshot;
pub mod world;

pub use error::{Error, Result};
