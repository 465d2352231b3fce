"""Clouds to voxels, MoveIt's planning scene to markers, and a camera for tests; no ROS."""
