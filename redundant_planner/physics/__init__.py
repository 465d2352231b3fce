"""The arm and its obstacles as bodies with mass, by MuJoCo; no ROS."""

from __future__ import annotations

from redundant_planner.core.errors import PlannerError


class PhysicsError(PlannerError):
    """MuJoCo is missing, or cannot do what it should."""


def require_mujoco() -> None:
    """Make sure that MuJoCo is installed.

    Raises:
        PhysicsError: it is not, with how to install it.
    """
    try:
        import mujoco  # noqa: F401
    except ImportError as error:
        raise PhysicsError(
            f"MuJoCo cannot be imported ({error}); pip install 'redundant_planner[mujoco]'"
        ) from None
