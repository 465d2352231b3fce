"""The ROS nodes: they convert, check ages, call the core and publish."""
