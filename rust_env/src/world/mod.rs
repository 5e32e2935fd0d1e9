//! What is: geometry, motion, sensing. Knows nothing of the belief wing.
pub mod render;
pub mod scene;
pub mod scenes;
