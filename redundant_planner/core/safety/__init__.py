"""Limits, barriers, and the QP that keeps them."""
