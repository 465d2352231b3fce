"""Scenes that others published, read from a checkout of their repositories."""
