"""The package as a user imports it: its names, robots from files, and simulated motions."""

from __future__ import annotations

import ast
from pathlib import Path
import subprocess
import sys

from closed_loop import drive, NOTHING
from conftest import PANDA_READY, PANDA_URDF, planar_urdf, ROBOTS
import numpy as np
import pytest

import redundant_planner
from redundant_planner import (
    Capsule,
    Obstacle,
    ParameterError,
    Planner,
    PlannerError,
    PlannerParameters,
    Preview,
    Robot,
    RobotError,
    Scene,
    simulate,
    StateError,
)
from redundant_planner.io.robot_files import load_robot

TWIST = [-0.029, -0.05, 0.004, 0.0, 0.0, 0.0]
START = [0.1, 0.1, 0.0, 0.52, -0.52, 1.05, 0.0]
BALL = Obstacle('ball', center=[0.0, 0.55, 0.45], semi_axes=[0.05, 0.03, 0.03])
PAPER_ARM = 'package://redundant_planner/config/robots/paper_2p5r.yaml'
BOX = ('<collision><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.1 0.1"/></geometry>'
       '</collision>')


def run(code: str) -> str:
    return subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          check=True).stdout.strip()


def arm_with_boxes(first: str = BOX) -> str:
    """The planar arm with collision geometry on its first and second link."""
    text = planar_urdf().replace('<link name="link1"/>', f'<link name="link1">{first}</link>')
    return text.replace('<link name="link2"/>', f'<link name="link2">{BOX}</link>')


def test_importing_the_package_loads_nothing_else():
    assert run('import sys; before = set(sys.modules); import redundant_planner\n'
               'dir(redundant_planner)\n'
               'print(*{m.split(".")[0] for m in set(sys.modules) - before}'
               ' - {"redundant_planner", *sys.stdlib_module_names})') == ''


def test_every_public_name_loads_without_ros():
    assert run('import sys; from redundant_planner import *\n'
               'assert all(name in globals() for name in __import__("redundant_planner").__all__)'
               '\nprint("rclpy" in sys.modules)') == 'False'


def test_the_public_names_are_typed_listed_and_documented():
    tree = ast.parse(Path(redundant_planner.__file__).read_text())
    typed = {alias.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)
             and node.module.startswith('redundant_planner.') for alias in node.names}
    assert typed == set(redundant_planner.__all__) <= set(dir(redundant_planner))
    for name in redundant_planner.__all__:
        assert getattr(redundant_planner, name).__doc__, name
    assert Path(redundant_planner.__file__).with_name('py.typed').is_file()
    with pytest.raises(AttributeError, match="'redundant_planner' has no attribute 'Planer'"):
        redundant_planner.Planer  # noqa: B018


def test_links_get_capsules_unless_told_otherwise(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    file = tmp_path / 'arm.urdf'
    file.write_text(arm_with_boxes())
    fitted = Robot.from_urdf(file, 'tip', axes=('vx', 'vy'))
    assert isinstance(fitted, Robot) and [c.frame for c in fitted.capsules] == ['link1', 'link2']
    assert all(c.radius > 0.05 for c in fitted.capsules)
    np.testing.assert_array_equal(fitted.acceleration_max, np.full(3, 5.0))
    straight = Robot.from_urdf(str(file), 'tip', axes=('vx', 'vy'), link_radius=0.03)
    assert [c.radius for c in straight.capsules] == [0.03] * 3
    own = Capsule('arm', 'link1', [0.0, 0.0, 0.0], [0.5, 0.0, 0.0], 0.04)
    assert Robot.from_urdf(file, 'tip', capsules=[own]).capsules == (own,)
    with pytest.raises(RobotError, match="the links have no shapes: give 'capsules', or"):
        Robot(file.read_text(), 'tip')


def test_a_link_without_collision_geometry_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    file = tmp_path / 'arm.urdf'
    file.write_text(arm_with_boxes(BOX.replace('collision', 'visual')))
    with pytest.warns(UserWarning, match=r"nothing keeps obstacles away: 'link1'"):
        robot = Robot.from_urdf(file, 'tip')
    assert [c.frame for c in robot.capsules] == ['link2']
    file.write_text(planar_urdf())
    with pytest.raises(RobotError, match=r'no moving link .* has collision geometry'):
        Robot.from_urdf(file, 'tip')
    with pytest.raises(PlannerError, match='is not a file'):
        Robot.from_urdf(tmp_path / 'gone.urdf', 'tip')


def test_meshes_are_found_from_the_urdf_alone(tmp_path):
    """The Panda's lie in a package that is not installed, around the URDF."""
    robot = Robot.from_urdf(PANDA_URDF, 'panda_hand')
    assert robot.n == 7 and len(robot.capsules) >= 7
    expected = load_robot(ROBOTS / 'xarm7.yaml', urdf=str(PANDA_URDF), base_frame='',
                          tip_frame='panda_hand')
    for ours, theirs in zip(robot.capsules, expected.capsules, strict=True):
        assert ours.radius == theirs.radius and ours.frame == theirs.frame


def test_a_parameter_file_makes_the_same_robot_everywhere(tmp_path):
    robot, loaded = Robot.from_file(PAPER_ARM), load_robot(ROBOTS / 'paper_2p5r.yaml')
    assert type(robot) is type(loaded) is Robot
    assert robot.axes == loaded.axes == ('vx', 'vy', 'vz')
    np.testing.assert_array_equal(robot.acceleration_max, loaded.acceleration_max)
    assert Robot.from_file(ROBOTS / 'paper_2p5r.yaml', link_radius=0.02).capsules[0].radius == 0.02
    (tmp_path / 'bad.yaml').write_text('nothing: here')
    with pytest.raises(ParameterError, match='is not a parameter file'):
        Robot.from_file(tmp_path / 'bad.yaml')


def test_a_motion_is_the_closed_loop(paper_arm):
    planner = Planner(paper_arm, PlannerParameters())
    motion = simulate(planner, START, TWIST, Scene.of([BALL]), 0.4, 0.004)
    postures, results = drive(Planner(paper_arm, PlannerParameters()), START, np.array(TWIST),
                              Scene.of([BALL]), 0.4)
    np.testing.assert_array_equal(motion.positions, postures)
    np.testing.assert_array_equal(motion.velocities, [r.dq for r in results])
    np.testing.assert_allclose(motion.times, 0.004 * np.arange(101), atol=1e-12)
    assert len(motion.results) == 100 and motion.clearance.shape == (101,)
    again = simulate(planner, START, lambda time: TWIST, Scene.of([BALL]), 0.4, 0.004)
    np.testing.assert_array_equal(motion.positions, again.positions)


def test_clearance_is_exact_at_the_margin_and_infinite_without_obstacles(paper_arm):
    """A sphere in front of the tool, in line with it: ‖x − c‖ − r, whatever the margin."""
    tip = paper_arm.kinematics(START).tip_position
    wrist = paper_arm.kinematics(START).segment_start[-1]
    outward = (tip - wrist) / np.linalg.norm(tip - wrist)
    for distance in (0.01, 0.04):
        ball = Obstacle('ball', tip + (0.05 + distance) * outward, [0.05] * 3)
        motion = simulate(Planner(paper_arm, PlannerParameters(clearance_margin=distance)), START,
                          np.zeros(6), Scene.of([ball]), 0.004, 0.004)
        np.testing.assert_allclose(motion.clearance, distance, atol=1e-9)
    free = simulate(Planner(paper_arm, PlannerParameters()), START, TWIST, NOTHING, 0.1, 0.004)
    assert np.isinf(free.clearance).all()


def test_obstacles_with_a_velocity_move_on(paper_arm):
    """Far away along x, so the distance falls by the obstacle's speed."""
    ball = Obstacle('ball', [3.0, 0.5, 0.5], [0.05] * 3, velocity=[-0.5, 0.0, 0.0])
    motion = simulate(Planner(paper_arm, PlannerParameters()), START, np.zeros(6),
                      Scene.of([ball]), 1.0, 0.01)
    np.testing.assert_allclose(np.diff(motion.clearance), -0.005, rtol=0.02)


def test_a_preview_is_seen_from_now(paper_arm):
    """`Planner.step` takes a preview that starts now, and a function of times from now."""
    line = np.array(TWIST)
    preview = Preview([0.0, 0.2, 3.0], [0.0 * line, line, line])
    parameters = PlannerParameters(method='variational')
    motion = simulate(Planner(paper_arm, parameters), START,
                      lambda time: preview.at(np.array([time]))[0], Scene.of([BALL]), 0.2, 0.004,
                      preview)
    planner, q = Planner(paper_arm, parameters), np.array(START)
    for i in range(50):
        now = 0.004 * i
        later = Preview(preview.times - now, preview.twists)
        q = q + 0.004 * planner.step(q, preview.at(np.array([now]))[0], Scene.of([BALL]), 0.004,
                                     later).dq
    np.testing.assert_allclose(q, motion.positions[-1], atol=1e-9)
    blind = simulate(Planner(paper_arm, parameters), START,
                     lambda time: preview.at(np.array([time]))[0], Scene.of([BALL]), 0.2, 0.004)
    assert np.abs(blind.positions - motion.positions).max() > 1e-6
    with pytest.raises(ValueError, match='read-only'):
        preview.times[0] = 1.0
    with pytest.raises(StateError, match="the times of the preview are 'soon'"):
        Preview('soon', [line])


@pytest.mark.parametrize(('change', 'message'), [
    ({'duration': 0.0}, r'duration is 0.0; it must be positive \[s\]'),
    ({'dt': -0.004}, r'dt is -0.004'), ({'dt': np.nan}, r'dt is nan'),
    ({'start': [0.0, 0.1]}, r'posture has shape \(2,\); the chain has 7 joints'),
    ({'twist': [1.0, 2.0]}, r'twist is \[1.0, 2.0\]; it takes six finite numbers'),
])
def test_bad_arguments_are_refused_by_name(panda, change, message):
    arguments = {'start': PANDA_READY, 'twist': np.zeros(6), 'scene': NOTHING, 'duration': 0.1,
                 'dt': 0.004, **change}
    with pytest.raises(StateError, match=message):
        simulate(Planner(panda, PlannerParameters()), **arguments)


def test_the_shortest_program_needs_no_parameters_and_no_scene(paper_arm):
    one = simulate(Planner(paper_arm), START, TWIST, [BALL], 0.4, 0.004)
    other = simulate(Planner(paper_arm, PlannerParameters()), START, TWIST, Scene.of([BALL]), 0.4,
                     0.004)
    np.testing.assert_array_equal(one.positions, other.positions)


def test_obstacles_in_a_list_are_those_of_a_scene_whatever_list_it_is(paper_arm):
    """A new list of the same obstacles is the same scene, and another obstacle is seen at once."""
    far = Obstacle('ball', center=[2.0, 2.0, 2.0], semi_axes=[0.05, 0.03, 0.03])
    planners = Planner(paper_arm), Planner(paper_arm)
    for things in ([far],) * 3 + ([BALL],) * 3 + ([],) * 2 + ((BALL, far),):
        results = [planner.step(np.array(START), np.array(TWIST), scene, 0.004)
                   for planner, scene in zip(planners, (list(things), Scene.of(things)))]
        np.testing.assert_array_equal(results[0].dq, results[1].dq)
        assert results[0].nearest == results[1].nearest
        assert (results[0].nearest is None) == (not things)


@pytest.mark.skipif(PANDA_URDF is None, reason='no Panda URDF')
def test_robots_that_come_with_the_package_are_found_by_name():
    panda = Robot.from_file('panda')
    assert panda.tip_frame == 'panda_hand' and len(panda.capsules) == 10
    np.testing.assert_array_equal(Robot.from_file('paper_2p5r').position_max,
                                  Robot.from_file(PAPER_ARM).position_max)
    tip = panda.kinematics(panda.ready).tip_position
    assert tip[0] > 0.3 and abs(tip[1]) < 0.2 and tip[2] > 0.3
    with pytest.raises(PlannerError, match=r"'pnada' is neither a file nor a robot.*'panda'"):
        Robot.from_file('pnada')


def test_without_its_description_a_robot_by_name_says_what_to_install(monkeypatch):
    monkeypatch.setattr('redundant_planner.io.robot_files.panda_urdf', lambda: None)
    with pytest.raises(PlannerError, match='pip install example-robot-data'):
        Robot.from_file('panda')
