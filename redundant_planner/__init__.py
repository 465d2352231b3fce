"""Velocity-level redundancy resolution for robot arms among ellipsoidal obstacles."""

__version__ = '0.1.0'
