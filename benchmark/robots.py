"""The robots of config/ that benchmarks drive, with changes."""

from __future__ import annotations

from typing import Any

from redundant_planner.core.parameters import AXES
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.resources import share_directory
from redundant_planner.io.robot_files import load_robot
from redundant_planner.tools.reproduce_paper import find_panda


def make_robot(name: str, axes: int, **changes: Any) -> Robot:
    """Return a robot of config/ with 3 or 6 controlled axes, and other parameters changed."""
    if name == 'panda':
        panda = find_panda(None)
        if panda is None:
            raise SystemExit('no Panda URDF: pip install example-robot-data')
        return load_robot(share_directory() / 'config' / 'robots' / 'panda.yaml',
                          urdf='', robot_description=panda.urdf, axes=AXES[:axes],
                          **changes)
    return load_robot(share_directory() / 'config' / 'robots' / 'paper_2p5r.yaml',
                      axes=AXES[:axes], link_radius=0.03, **changes)
