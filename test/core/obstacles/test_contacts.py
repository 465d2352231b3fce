"""Contacts that are meant, and those that are not."""

from __future__ import annotations

from closed_loop import drive, smallest_level
from conftest import PANDA_READY
import numpy as np
import pytest

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.obstacles.contacts import AllowedContacts
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.workspace import walls
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.stage import Stage

DOWN, ALONG = np.array([0.0, 0, -0.05, 0, 0, 0]), np.array([0.0, 0.1, 0, 0, 0, 0])
ALLOWED = ('panda_hand:table',)


def table_at(robot, depth):
    """A table whose top is this far above the lowest point of the fingers [m]."""
    arm, radius = robot.kinematics(PANDA_READY), robot.capsules[-1].radius
    top = min(arm.segment_start[-1, 2], arm.segment_end[-1, 2]) - radius + depth
    return Scene.of([Obstacle.box('table/7', (0.75, 0.0, top - 0.05), (1.0, 2.0, 0.1))])


def motion(robot, depth, twist, allowed, method='dynamic_factor', seconds=2.0):
    planner = Planner(robot, PlannerParameters(method=method, allowed_contacts=allowed))
    scene = table_at(robot, depth)
    postures, results = drive(planner, PANDA_READY, twist, scene, seconds)
    tips = [robot.kinematics(q).tip_position for q in (postures[0], postures[-1])]
    return tips[1] - tips[0], smallest_level(robot, postures, scene), results


def test_what_may_touch_goes_by_the_names_that_there_are_now(panda):
    """As many obstacles as before may come in another order, or be others."""
    allowed, names = AllowedContacts(ALLOWED, panda), ('table', 'box', 'table/7')
    flags = allowed.among(names)
    assert flags.any(axis=0).tolist() == [True, False, True]
    np.testing.assert_array_equal(allowed.among(('box', 'table', 'table/7')), flags[:, [1, 0, 2]])
    assert not allowed.among(('box', 'shelf', 'person')).any()


@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
def test_what_may_touch_comes_down_to_the_surface_and_no_further(panda, method):
    kept, level, _ = motion(panda, -0.05, DOWN, (), method)
    touching, contact, results = motion(panda, -0.05, DOWN, ALLOWED, method)
    assert level > 0.0 and kept[2] == pytest.approx(-0.04, abs=2e-3)
    assert contact > -1e-4 and touching[2] == pytest.approx(-0.05, abs=1e-3)
    # It is no clearance that the arm minds.
    assert results[-1].nearest.link == 'link7'
    assert results[-1].clearance_index > 1.0


@pytest.mark.parametrize('depth', [0.0, 0.01, 0.03])
def test_a_contact_that_is_allowed_may_last_but_not_get_deeper(panda, depth):
    start = smallest_level(panda, [PANDA_READY], table_at(panda, depth))
    moved, level, results = motion(panda, depth, DOWN, ALLOWED)
    assert abs(moved[2]) < 1e-3 and level > start - 1e-3
    assert {result.stage for result in results} <= {Stage.DESIRED, Stage.SCALED}
    # Along the surface, out of it, and not at all.
    moved, level, results = motion(panda, depth, ALONG, ALLOWED)
    assert moved[1] == pytest.approx(0.2, abs=0.01) and level > start - 1e-2
    moved, _, _ = motion(panda, depth, -DOWN, ALLOWED)
    assert moved[2] == pytest.approx(0.1, abs=0.01)
    moved, _, _ = motion(panda, depth, np.zeros(6), ALLOWED)
    np.testing.assert_allclose(moved, 0.0, atol=1e-6)


@pytest.mark.first_alone
@pytest.mark.parametrize('depth', [0.0, 0.01, 0.03])
@pytest.mark.parametrize('twist', [np.zeros(6), DOWN])
def test_a_contact_that_is_not_allowed_ends(panda, depth, twist):
    """Standing still over a face that is parallel to the fingers, too: a degenerate problem."""
    moved, _, results = motion(panda, depth, twist, ('panda_link6:table', 'panda_hand:shelf'))
    assert moved[2] > depth + 0.008
    assert {result.stage for result in results} <= {Stage.YIELDING, Stage.FORCED}


@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
def test_other_links_and_obstacles_keep_their_margin(panda, method):
    """A hand that may touch the table pushes along it, towards a box that it may not touch."""
    scene = table_at(panda, 0.0)
    box = Obstacle.box('box', (0.3, 0.35, 0.5), (0.4, 0.2, 0.3))
    planner = Planner(panda, PlannerParameters(method=method, allowed_contacts=ALLOWED))
    postures, results = drive(
        planner, PANDA_READY, ALONG, Scene.of([*scene.obstacles(), box]), 4.0)
    assert smallest_level(panda, postures, Scene.of([box])) > 0.0
    assert results[-1].nearest.obstacle == 'box' and results[-1].scale < 0.2


def test_what_touches_is_named_with_its_depth_and_whether_it_may(panda):
    scene = table_at(panda, 0.02)
    for allowed in ((), ALLOWED):
        planner = Planner(panda, PlannerParameters(allowed_contacts=allowed))
        found, = planner.contacts(PANDA_READY, scene)
        assert found.link == 'fingers' and found.obstacle == 'table/7'
        assert found.depth == pytest.approx(0.02, abs=1e-6) and found.allowed is bool(allowed)
        hint = 'may not get deeper' if allowed else "add 'fingers:table/7' to allowed_contacts"
        assert '20 mm deep' in str(found) and hint in str(found)
    planner = Planner(panda, PlannerParameters())
    assert not planner.contacts(PANDA_READY, table_at(panda, -0.02))
    beyond = planner.contacts(PANDA_READY, Scene.of(walls((-2, -2, -2, 2, 2, 0.7))))
    assert {found.link for found in beyond} == {'link4', 'link5', 'link6'}
    assert all(found.allowed for found in beyond)


def test_names_of_obstacles_may_be_namespaces_and_those_of_links_capsules_or_links(panda):
    names = ('table', 'table/7', 'tablet/1', 'cup')
    for entry, links, count in (
            ('panda_hand:table', {'hand', 'fingers'}, 2), ('fingers:table', {'fingers'}, 2),
            ('hand:table/7', {'hand'}, 1), ('attached:table', set(), 0),
            ('panda_link0:table', {'base'}, 2)):
        flags = AllowedContacts([entry], panda).among(names)
        assert {panda.capsules[i].name for i in np.flatnonzero(flags.any(axis=1))} == links
        assert flags.any(axis=0).sum() == count
    assert AllowedContacts([], panda).among(names) is None
    several = AllowedContacts(['hand:cup', 'link6:table'], panda).among(names)
    assert several.sum() == 3


@pytest.mark.parametrize('entry', ['table', ':table', 'hand:', ''])
def test_an_entry_that_is_none_is_refused(entry):
    with pytest.raises(ParameterError, match=r"'allowed_contacts' has .*'link:obstacle'"):
        PlannerParameters(allowed_contacts=(entry,))


def test_a_link_that_the_arm_does_not_have_is_refused_and_changes_nothing(panda):
    planner = Planner(panda, PlannerParameters())
    before = planner.parameters
    with pytest.raises(ParameterError, match="no link 'panda_hnd' with a shape"):
        planner.parameters = PlannerParameters(
            allowed_contacts=('panda_hnd:table',), clearance_margin=0.1)
    assert planner.parameters is before
    results = drive(planner, PANDA_READY, DOWN, table_at(panda, -0.05))[1]
    assert results[0].nearest.beyond_margin > 0.03


@pytest.mark.first_alone
@pytest.mark.parametrize('make', [
    lambda c, h: Obstacle('o', c, h), lambda c, h: Obstacle.box('o', c, 2.0 * h),
    lambda c, h: Obstacle.cylinder('o', c, h[0], 2.0 * h[2]),
    lambda c, h: Obstacle.capsule('o', c, h[0], 2.0 * h[2])])
def test_any_shape_may_be_touched(panda, make):
    """Each below the fingers, 3 cm away; and the same as one of many, far from which all are."""
    arm, radius = panda.kinematics(PANDA_READY), panda.capsules[-1].radius
    tip = 0.5 * (arm.segment_start[-1] + arm.segment_end[-1])
    half = np.array([0.05, 0.05, 0.05])
    one = make(tip - [0.0, 0.0, radius], half)
    one = make(one.center - [0.0, 0.0, one.half_extents[2] + 0.03], half)
    far = [Obstacle(f'f{i}', (3.0, 0.1 * i, 0.0), (0.01, 0.01, 0.01)) for i in range(30)]
    for scene in (Scene.of([one]), Scene.of([one, *far])):
        lowest = []
        for allowed in ((), ('panda_hand:o',)):
            planner = Planner(panda, PlannerParameters(allowed_contacts=allowed))
            postures, _ = drive(planner, PANDA_READY, DOWN, scene, 2.0)
            lowest.append(panda.kinematics(postures[-1]).tip_position[2])
            assert smallest_level(panda, postures, scene) > -1e-3
        assert lowest[0] - lowest[1] == pytest.approx(0.01, abs=3e-3)
