"""The arms of the PyPI package example-robot-data, as a new user has them: a URDF and no more."""

from __future__ import annotations

from collections.abc import Container, Iterator
from pathlib import Path
import sysconfig

from redundant_planner.core.errors import PlannerError
from redundant_planner.core.robot import model
from redundant_planner.io.likely_tips import likely_tip
from redundant_planner.io.parameter_files import urdf_text
from redundant_planner.io.resources import read_text
from redundant_planner.io.robot_files import build_robot
from redundant_planner.tools.show_robot import described_by_urdf

ROBOTS = (Path(sysconfig.get_paths()['purelib']) / 'cmeel.prefix' / 'share'
          / 'example-robot-data' / 'robots')
_JOINTS = (6, 7)


def arms(joints: Container[int] = _JOINTS) -> Iterator[tuple[Path, int]]:
    """Yield the URDFs of example-robot-data whose likely chain has so many joints.

    With each comes the number of joints.

    Args:
        joints: how many; six or seven if not given.
    """
    for path in sorted(ROBOTS.rglob('*.urdf')):
        try:
            text = read_text(path)
            robot = model.Robot(text, likely_tip(text), capsules=[], velocity_max=1.0)
        except PlannerError:  # no arm at all: rotors, or joints that cannot move
            continue
        if robot.n in joints and 'collision' in text:
            yield path, robot.n


def load_arm(urdf: Path) -> model.Robot:
    """Return an arm as `quick_start` takes it, with capsules fitted to its meshes.

    Raises:
        PlannerError: the URDF cannot be read, or describes no such arm.
    """
    parameters = described_by_urdf(str(urdf), '', '', lambda _: None).parameters
    return build_robot(parameters, urdf_text(parameters), {})
