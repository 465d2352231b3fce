"""The row that keeps an arm out of singularities: its gradient, and that it never jumps."""

from __future__ import annotations

from conftest import make_panda, make_planar, random_postures
import numpy as np
import pytest

from redundant_planner.core import planner as planner_module
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.barriers import barriers_in, SINGULARITY

# A margin that all postures are near to.
PANDA, MARGIN = make_panda(), 0.2
PARAMETERS = PlannerParameters(singularity_margin=MARGIN)


def kept(q):
    """(Σ 1/(σ² + ε²))^(−½), ε a quarter of the margin."""
    sigma = np.linalg.svd(PANDA.kinematics(q).jacobian, compute_uv=False)
    return float((1.0 / (sigma ** 2 + (0.25 * MARGIN) ** 2)).sum() ** -0.5)


@pytest.fixture
def row_at(monkeypatch):
    """The gradient (n,) and value of the row at a posture."""
    wishes = []
    wish = planner_module.wish

    def noted(*arguments):
        wishes.append(wish(*arguments))
        return wishes[-1]

    monkeypatch.setattr(planner_module, 'wish', noted)

    def row(robot, q):
        planner = Planner(robot, PARAMETERS)
        planner.step(q, np.zeros(6), Scene.of([]), 0.004)
        rows = barriers_in(planner._setup.value.rows, wishes[-1].rows_used)
        at = int(np.flatnonzero(rows.kind == SINGULARITY)[0])
        return rows.gradient[at].copy(), float(rows.value[at])
    return row


@pytest.mark.parametrize('q', random_postures(PANDA, 20))
def test_the_gradient_is_that_of_what_it_keeps(row_at, q):
    gradient, value = row_at(PANDA, q)
    step = 1e-6
    for j, way in enumerate(step * np.eye(PANDA.n)):
        assert gradient[j] == pytest.approx(
            (kept(q + way) - kept(q - way)) / (2.0 * step), abs=2e-4)
    assert value == pytest.approx(max(kept(q) - MARGIN * np.sqrt(1.0625), 0.0), abs=1e-9)


def test_the_gradient_passes_a_singularity_without_a_jump(row_at):
    """Where a planar arm is straight, σ is 0 and its own gradient turns round at once."""
    robot = make_planar()
    gradients = [row_at(robot, np.array([0.3, offset, offset]))[0]
                 for offset in np.linspace(-4e-3, 4e-3, 17)]
    assert np.linalg.norm(np.diff(gradients, axis=0), axis=1).max() < 0.02
    assert np.linalg.norm(gradients[8]) < 1e-6
