//! What is: geometry, motion, sensing. Knows nothing of the belief wing.
pub mod scene;
pub mod scenes;
