"""Obstacles, and how far links are from them and from each other."""
