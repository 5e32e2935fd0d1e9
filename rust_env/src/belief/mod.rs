//! What the robot knows: the map, its own estimated pose, and what can be computed from these two.
