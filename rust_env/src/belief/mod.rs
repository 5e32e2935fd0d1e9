//! What the robot knows: the map, its own estimated pose, and what can be computed from these two.
pub mod octree;
pub mod ray_walk;
