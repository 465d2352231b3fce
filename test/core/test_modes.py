"""What share of its command an arm goes along its path while it steps aside."""

from __future__ import annotations

from types import SimpleNamespace

from conftest import make_panda, PANDA_READY
import numpy as np
import pytest

from redundant_planner.core.horizon.evasive_plan import Aside
from redundant_planner.core.modes import SteppingAside
from redundant_planner.core.redundancy.reference import Task
from redundant_planner.core.safety.stages import Filtered

PANDA = make_panda()
JACOBIAN = PANDA.kinematics(PANDA_READY).jacobian
COMMAND = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])


def share(along, off):
    """Return it of a tip that goes at `along` times its command, its reference `off` [m] ahead."""
    error = np.array([*off, 0.0, 0.0, 0.0])
    task = Task(np.array([COMMAND, np.zeros(6), np.zeros(6)]), error)
    dq = np.linalg.pinv(JACOBIAN) @ (along * COMMAND)
    mode = SteppingAside(Aside(dq, True, 'a ball'), None, PANDA)
    return mode.rated(Filtered.untouched(dq), SimpleNamespace(task=task),
                      SimpleNamespace(arm=SimpleNamespace(jacobian=JACOBIAN))).scale


@pytest.mark.parametrize('along', [0.0, 0.3, 1.0])
def test_a_tip_beside_its_path_goes_along_as_far_as_it_moves_along(along):
    for off in ((0.0, 0.0, 0.0), (0.0, 0.1, -0.2)):
        assert share(along, off) == pytest.approx(along)


def test_the_reference_catches_up_with_a_tip_ahead_and_waits_for_one_behind():
    assert share(0.3, (-0.002, 0.0, 0.0)) > 0.31 and share(0.3, (0.002, 0.0, 0.0)) < 0.29
    assert share(0.0, (-1.0, 0.0, 0.0)) == 1.0 and share(1.0, (1.0, 0.0, 0.0)) == 0.0
