"""The mathematics of the planner: NumPy, Pinocchio and DAQP, nothing of ROS."""
