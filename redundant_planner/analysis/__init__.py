"""Recordings of a motion: writing and reading bags, measuring and drawing what they hold."""
