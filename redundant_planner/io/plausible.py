"""How large a number may be before nobody can have meant or measured it."""

from __future__ import annotations

# A twist's largest entry, even if linear_speed_max would slow it [m/s, rad/s].
FASTEST = 1e3
# The largest position and velocity of a joint [rad, m; per s].
LARGEST = 1e6
