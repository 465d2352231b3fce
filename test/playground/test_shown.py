"""What the page draws and measures is where the arm is."""

from __future__ import annotations

from types import SimpleNamespace

from conftest import make_panda, PANDA_READY, PANDA_URDF
import numpy as np
import pytest

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.io.collision_geometry import collision_pieces
from redundant_planner.io.link_surfaces import link_surfaces
from redundant_planner.playground.arm_view import capsule_surface, LinksView
from redundant_planner.playground.figures_view import figures_html
from redundant_planner.playground.ghost import Ghost, METHODS_TO_COMPARE
from redundant_planner.playground.items_view import OthersView
from redundant_planner.playground.measures import nearest_pair, Tally
from redundant_planner.playground.planner_client import Motion

PANDA = make_panda()
ARM = PANDA.kinematics(PANDA_READY)
STILL = np.zeros(6)


def test_the_links_drawn_are_those_that_capsules_were_fitted_to():
    surfaces = link_surfaces(PANDA, PANDA_URDF.parent)
    corners = {}
    for piece in collision_pieces(PANDA, PANDA_URDF.parent):
        if piece.radius is None:
            corners.setdefault(piece.link, []).append(piece.points)
    drawn = {}
    for surface in surfaces:
        assert surface.triangles.max() < len(surface.vertices)
        drawn.setdefault(surface.link, []).append(surface.vertices)
    assert {'panda_link0', *corners} <= set(drawn)
    for link, points in corners.items():
        for end in (np.min, np.max):
            np.testing.assert_allclose(end(np.vstack(drawn[link]), axis=0),
                                       end(np.vstack(points), axis=0), atol=1e-6)


@pytest.mark.parametrize(('radius', 'length'), [(0.05, 0.3), (0.1, 0.0)])
def test_a_capsule_is_drawn_closed_and_on_its_surface(radius, length):
    vertices, triangles = capsule_surface(radius, length)
    ends = np.clip(vertices[:, 2], -0.5 * length, 0.5 * length)
    off = np.linalg.norm(vertices - np.column_stack((0 * ends, 0 * ends, ends)), axis=1)
    np.testing.assert_allclose(off, radius, rtol=1e-5)
    edges = {(a, b) for t in triangles.tolist() for a, b in zip(t, t[1:] + t[:1])}
    rims = {(a, b) for a, b in edges if (b, a) not in edges}
    # What is left open are the two poles, rings without a size.
    assert all(abs(abs(vertices[a][2]) - 0.5 * length - radius) < 1e-6 for a, _ in rims)


def test_the_nearest_pair_is_between_the_surfaces():
    hand = ARM.tip_position
    ball = Obstacle('ball', hand + (0.3, 0.0, 0.0), (0.05,) * 3)
    box = Obstacle.box('far', hand + (0.0, 0.0, 2.0), (0.1,) * 3)
    near = nearest_pair(PANDA, ARM, Scene.of([ball, box]))
    assert near.obstacle == 'ball'
    assert np.linalg.norm(near.ends[1] - ball.center) == pytest.approx(0.05, abs=1e-6)
    # The distance of an ellipsoid is a bound from below, and exact of a ball.
    assert np.linalg.norm(near.ends[0] - near.ends[1]) == pytest.approx(near.distance, abs=1e-3)
    assert nearest_pair(PANDA, ARM, Scene.of()) is None


class Drawn:
    """Stands for viser's scene: counts what is added, and keeps where it was moved to."""

    def __init__(self):
        self.added = 0

    def __getattr__(self, name):
        assert name.startswith('add_'), name

        def add(*_, **properties):
            self.added += 1
            return SimpleNamespace(**{
                'position': None, 'wxyz': None, 'visible': True, **properties,
                'remove': lambda: setattr(self, 'added', self.added - 1)})
        return add


def test_another_arm_that_moves_is_moved_and_not_drawn_anew():
    drawn = Drawn()
    view = OthersView(drawn)
    for i in range(50):
        arm = PANDA.kinematics(PANDA_READY + 0.01 * i)
        view.show(Scene.of([
            Obstacle.capsule(f'right/{capsule.name}/{k}', 0.5 * (start + end), capsule.radius,
                             float(np.linalg.norm(end - start)))
            for k, (capsule, start, end) in enumerate(zip(
                PANDA.capsules, arm.segment_start, arm.segment_end))]), frozenset())
        assert drawn.added == len(PANDA.capsules) == len(view._places)
    np.testing.assert_allclose(view._places[0][1].position,
                               0.5 * (arm.segment_start[0] + arm.segment_end[0]))
    # Another shape in its place is drawn anew, and what has gone is gone.
    view.show(Scene.of([Obstacle.box('thing', (1.0, 0.0, 0.0), (0.1, 0.1, 0.1))]), frozenset())
    assert len(view._places) == drawn.added == 1 and view._places[0][0][0] == 'box'
    # The page draws its own items and arms otherwise.
    ours = [Obstacle.box(name, (1.0, 0.0, 0.0), (0.1, 0.1, 0.1))
            for name in ('item/0', 'right/hand/3', 'theirs/0')]
    view.show(Scene.of(ours), frozenset(('item', 'right')))
    assert drawn.added == 1


def test_links_that_are_hidden_or_at_rest_are_left_alone():
    surfaces = link_surfaces(PANDA, PANDA_URDF.parent)
    view = LinksView(Drawn(), '/arm', PANDA, surfaces)
    for capsules in (False, True):
        view.show(links=not capsules, capsules=capsules)
        handles = (view._surfaces, view._capsules)
        for turn in (0.0, 0.1):
            view.move(PANDA.kinematics(PANDA_READY + turn))
            moved, left = handles[capsules], handles[not capsules]
            assert all(handle.position is not None for handle in moved)
            assert all(handle.position is None for handle in left)
        for handle in (*view._surfaces, *view._capsules):
            handle.position = None
        view.move(PANDA.kinematics(PANDA_READY + turn))
        assert all(handle.position is None for handle in moved)


@pytest.mark.parametrize('method', METHODS_TO_COMPARE)
def test_every_ghost_follows_the_command_and_counts_its_path(method):
    ghost = Ghost(PANDA, PlannerParameters(), method, PANDA_READY, 10.0)
    for i in range(1, 31):
        ghost.follow(np.array((0.0, 0.1, 0.0, 0.0, 0.0, 0.0)), None, Scene.of(), 10.0 + i / 30)
    tip = PANDA.kinematics(ghost.q).tip_position
    np.testing.assert_allclose(tip - ARM.tip_position, (0.0, 0.1, 0.0), atol=0.012)
    assert ghost.tally.path >= np.linalg.norm(ghost.q - PANDA_READY) > 0.05
    assert ghost.tally.distance == np.inf


@pytest.mark.parametrize('method', ["the paper's, to the letter", 'dynamic factor'])
def test_a_ghost_goes_to_a_target_too(method):
    goal = Pose(ARM.tip_position + (0.0, 0.1, 0.05), ARM.tip_rotation)
    ghost = Ghost(PANDA, PlannerParameters(), method, PANDA_READY, 0.0)
    for i in range(1, 151):
        ghost.follow(STILL, goal, Scene.of(), i / 30)
    tip = PANDA.kinematics(ghost.q).tip_position
    np.testing.assert_allclose(tip, goal.position, atol=2e-3)


def test_least_norm_is_the_shortest_step():
    ghost = Ghost(PANDA, PlannerParameters(), 'least norm: J⁺ẋ alone', PANDA_READY, 0.0)
    twist = np.array((0.0, 0.1, 0.0, 0.0, 0.0, 0.0))
    ghost.follow(twist, None, Scene.of(), 0.0101)
    np.testing.assert_allclose(
        (ghost.q - PANDA_READY) / 0.01, np.linalg.pinv(ARM.jacobian) @ twist, atol=1e-9)


def test_a_tally_counts_the_way_and_keeps_the_smallest():
    tally = Tally(np.zeros(2))
    for q, distance in (((3.0, 4.0), 0.5), ((0.0, 0.0), 0.2), ((0.0, 1.0), 0.9)):
        tally.take(np.array(q), distance)
    assert tally.path == pytest.approx(11.0)
    assert (tally.smallest, tally.distance) == (0.2, 0.9)


def test_figures_say_what_exceeds_a_limit_and_escape_what_others_named():
    motion = Motion(PANDA_READY, np.zeros(7), np.zeros(7))
    motion.commanded[2] = 2.0 * PANDA.velocity_max[2]
    status = {'message': '<script>alert(1)</script>', 'stage': '<b>', 'twist scale s': 'nonsense'}
    near = SimpleNamespace(link='<i>', obstacle='<u>', distance=-0.01)
    text = figures_html(PANDA, motion, status, near, {'message': '<x>', 'distance [m]': '0.1'})
    for name in ('<script', '<b>alert', '<i>\n', '<u>', '<x>'):
        assert name not in text
    assert text.count('class="over"') == 1 and 'class="bad">-10 mm' in text
    calm = figures_html(PANDA, Motion(PANDA_READY, np.zeros(7), np.zeros(7)), {}, None, {})
    assert 'class="over"' not in calm and 'nothing is near' in calm
