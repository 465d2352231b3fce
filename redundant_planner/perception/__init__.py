"""What a depth camera sees: point clouds to voxels, and a camera for tests; no ROS."""
