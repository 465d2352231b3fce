"""Measurements: `python -m benchmark.scenarios` and others; nothing here is installed."""
