"""Obstacles' courses into links, against brute force."""

from __future__ import annotations

from conftest import random_postures
import numpy as np
import pytest
from test_evasion import HORIZON, joints_of, LEAD, maps_of, MARGIN, passing

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.courses import deepest_threat


@pytest.mark.parametrize('count', [2, 20])
def test_the_deepest_course_into_a_link_is_found(panda, count):
    random, joints, outcomes = np.random.default_rng(1), joints_of(panda), []
    times = np.linspace(0.0, HORIZON, 1001)
    for q in random_postures(panda, 60):
        arm, scene = panda.kinematics(q), passing(panda, random, count)
        maps = maps_of(panda, scene)
        still = [np.tile(ends, (len(times), 1, 1)) for ends in (
            arm.segment_start, arm.segment_end)]
        depth = (link_clearance(maps, *still, times).distance.min(axis=0) + MARGIN
                 + LEAD * maps.speeds)[joints.links]
        link, obstacle = deepest_threat(
            panda.links(arm), maps, joints, MARGIN, LEAD)
        if abs(depth.min()) > 1e-3:
            assert (link >= 0) == (depth.min() < 0.0)
        if link >= 0:
            at = joints.links.tolist().index(link)
            assert depth[at, obstacle] == pytest.approx(depth.min(), abs=1e-3)
        outcomes.append(link >= 0)
    assert (10 < sum(outcomes) < 50) == (count == 2)


