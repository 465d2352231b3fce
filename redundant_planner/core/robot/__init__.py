"""The arm: its model, kinematics and shape."""
