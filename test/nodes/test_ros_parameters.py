"""Parameters as ROS gives them: which value holds, which are refused, which nobody reads."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import fields

from conftest import ROBOTS
from live_helpers import run_node
import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from ros_domains import next_domain
import yaml

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.parameters import ros_name, spec_of
from redundant_planner.io.parameter_files import RobotParameters, SETTINGS
from redundant_planner.nodes.disputed_parameters import disputed
from redundant_planner.nodes.ros_parameters import (
    changed,
    changed_entries,
    checked_entry,
    declare,
    FakeHardwareParameters,
    parameter_page,
    PlannerNodeParameters,
    refuse_unknown_parameters,
    STATIC_OBSTACLE,
)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / 'a.yaml'
    path.write_text('/**:\n  ros__parameters:\n    criteria.k_w: 5\n    criteria.k_s: 2.5\n'
                    '    horizon.duration: 2\n'
                    '    static_obstacle:\n      wall:\n        center: [1, 0, 0]\n')
    return str(path)


@pytest.mark.parametrize(('arguments', 'expected'), [
    ([], {}),
    (['--params-file', 'FILE'], {}),
    (['--params-file', 'FILE', '-p', 'criteria.k_w:=7.5'], {'criteria.k_w': 7.5}),
    (['-p', 'criteria.k_w:=7.5', '--params-file', 'FILE'], {'criteria.k_w': 7.5}),
    (['--params-file', 'FILE', '--param', 'criteria.k_s:=9'], {'criteria.k_s': 9}),
    (['--params-file', 'FILE', '-p', 'planner_node:criteria.k_w:=1e5'], {'criteria.k_w': 1e5}),
    (['--params-file', 'FILE', '-p', 'other_node:criteria.k_w:=7.5'], {}),
    (['--params-file', 'FILE', '-p', 'static_obstacle.wall.center:=[0.5, 0.0, 0.0]'],
     {'static_obstacle.wall.center': [0.5, 0.0, 0.0]}),
    (['-p', 'criteria.k_w:=1', '-p', 'criteria.k_w:=2.5'], {'criteria.k_w': 2.5}),
    (['-p', 'criteria.k_w:=1', '-p', 'criteria.k_s:=2.5'], {}),
    (['--params-file', 'FILE', '--', '-p', 'criteria.k_w:=7.5'], {}),
])
def test_the_last_value_given_holds_and_the_command_lines_before_a_files(
        file, arguments, expected):
    line = ['planner_node', '--ros-args', *(file if a == 'FILE' else a for a in arguments)]
    assert disputed(tuple(line), '/planner_node') == expected


@pytest.mark.parametrize(('section', 'counts'), [
    ('/**', True), ('/arm/planner_node', True), ('/*/planner_node', True), ('/arm/*', True),
    ('/**/planner_node', True), ('planner_node', False), ('/*', False), ('/arm', False)])
def test_sections_of_files_count_for_the_nodes_they_name(file, tmp_path, section, counts):
    other = tmp_path / 'b.yaml'
    other.write_text(f'{section}:\n  ros__parameters: '
                     '{criteria: {k_w: 7.5}, horizon.duration: 3}\n')
    line = ('planner_node', '--ros-args', '--params-file', file, '--params-file', str(other))
    assert disputed(line, '/arm/planner_node') == ({'criteria.k_w': 7.5} if counts else {})


def test_namespaces_of_files_may_be_nested(file, tmp_path):
    other = tmp_path / 'b.yaml'
    other.write_text('arm:\n  planner_node:\n    ros__parameters: {criteria.k_w: 7.5}\n')
    line = ('planner_node', '--ros-args', '--params-file', file, '--params-file', str(other))
    assert disputed(line, '/arm/planner_node') == {'criteria.k_w': 7.5}


@pytest.mark.long
def test_files_may_have_tags_as_those_of_launch_ros(tmp_path):
    """It writes lists as Python tuples, and rcl looks at no tags."""
    path = tmp_path / 'launch.yaml'
    path.write_text(yaml.dump({'/**': {'ros__parameters': {
        'initial_joints': ('d1', 'd2'), 'initial_positions': (0.1, 0.2)}}}))
    assert '!!python/tuple' in path.read_text()
    line = ('fake_hardware_node', '--ros-args', '--params-file', str(path), '-p',
            'initial_positions:=[0.3, 0.4]')
    assert disputed(line, '/fake_hardware_node') == {'initial_positions': [0.3, 0.4]}
    status, said = run_node('fake_hardware_node', *line[2:])
    assert status == 2 and "'urdf' is empty" in said, said


def test_a_decimal_on_the_command_line_wins_over_a_whole_number_in_a_file(tmp_path):
    """With a real node: rcl keeps the file's 250, which would be in range."""
    path = tmp_path / 'fake.yaml'
    path.write_text('/**:\n  ros__parameters:\n    command_timeout: 1\n')
    status, said = run_node('fake_hardware_node', '--params-file', str(path), '-p',
                            'command_timeout:=10.5')
    assert status == 2 and "'command_timeout' is 10.5; it must lie in [0.001, 10] s" in said


@contextmanager
def node_with(*arguments, name='planner_node'):
    context = Context()
    rclpy.init(context=context, domain_id=next_domain())
    node = Node(name, context=context, cli_args=['--ros-args', *arguments],
                start_parameter_services=False, enable_rosout=False)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def refused(node):
    with pytest.raises(ParameterError) as refusal:
        refuse_unknown_parameters(node)
    return str(refusal.value)


def test_parameters_that_nobody_reads_are_refused():
    given = {'horizon.look_aheed': 1.0, 'criteria.k_w': 2.0,
             'scenario': 'x', 'use_sim_time': False,
             'noise': 0.05, 'capsules': '[arm]', 'capsule.arm.radius': 0.1,
             'capsule.arm.radios': 0.1, 'static_obstacle.wal.center': '[0.0, 0.0, 0.0]',
             'static_obstacles': '[wall]', 'qos_overrides./tf.depth': 3, 'zzz': 1}
    arguments = [a for name, value in given.items() for a in ('-p', f'{name}:={value}')]
    wrong = ["parameter 'capsule.arm.radios' is not known; did you mean 'capsule.arm.radius'?",
             "parameter 'horizon.look_aheed' is not known; did you mean 'horizon.look_ahead'?",
             "parameter 'zzz' is not known"]
    wall = ("parameter 'static_obstacle.wal.center' is not known; did you mean "
            "'static_obstacle.wall.center'?")
    with node_with(*arguments) as node:
        declare(node, RobotParameters)
        declare(node, PlannerNodeParameters)
        assert refused(node) == '; '.join([*wrong[:2], wall, wrong[2]])
    with node_with(*arguments, name='fake_hardware_node') as node:  # shares the planner's file
        declare(node, RobotParameters)
        declare(node, FakeHardwareParameters)
        assert refused(node) == '; '.join(wrong)


@pytest.mark.parametrize('node', ['planner_node', 'fake_hardware_node', 'scenario_player'])
def test_a_misspelt_parameter_ends_each_node_with_the_right_name(tmp_path, node):
    path = tmp_path / 'misspelt.yaml'
    path.write_text('/**:\n  ros__parameters:\n    limits.linear_sped: 0.1\n'
                    f'    urdf: {ROBOTS}/paper_2p5r.urdf\n    tip_frame: tool_tip\n')
    status, said = run_node(node, '--params-file', str(path))
    assert status == 2 and 'Traceback' not in said, said
    assert "'limits.linear_sped' is not known; did you mean 'limits.linear_speed'?" in said


@pytest.mark.parametrize('value', [
    'hello', ['a', 'b', 'c'], None, True, 1.0, [True, False, True], [1.0, 2.0],
    [np.nan, 0.0, 0.0], [np.inf, 0.0, 0.0], [b'a', b'b', b'c'], b'abc', {'a': 1, 'b': 2, 'c': 3},
    [[1.0], [2.0], [3.0]], [10**400, 0, 0], {}])
def test_values_that_fit_no_entry_are_refused_by_name(value):
    with pytest.raises(ParameterError, match=r"parameter 'static_obstacle\.my\.wall\.center'"):
        changed_entries('static_obstacle', STATIC_OBSTACLE,
                        {'static_obstacle.my.wall.center': value})


def test_names_of_obstacles_may_have_dots():
    assert changed_entries('static_obstacle', STATIC_OBSTACLE, {
        'static_obstacle.my.wall.center': [1, 2.5, 3], 'criteria.k_w': 1.0,
        'static_obstacles': ['a'],
        }) == {('my.wall', 'center'): [1.0, 2.5, 3.0]}
    assert checked_entry('capsule.a.radius', 1, 1) == 1.0


INFINITE = ('clearance_influence_distance', 'jerk_max', 'limits_linear_speed',
            'limits_angular_speed')


@pytest.mark.parametrize('settings', SETTINGS)
def test_absurd_numbers_make_no_parameter(settings):
    """Infinite is only what has a meaning: no obstacle out of reach, no limit."""
    for entry in fields(settings):
        numbers = isinstance(entry.default, (int, float)) or 'float' in str(entry.type)
        if isinstance(entry.default, bool) or not numbers:
            continue
        for value in (np.nan, np.inf, -np.inf, 1e308, -1e308, 10**400):
            if value >= 1e308 and entry.name in INFINITE:
                continue
            given = (value,) if isinstance(entry.default, tuple) else value
            with pytest.raises(ParameterError, match=f"'{ros_name(entry)}'"):
                changed([settings()], {ros_name(entry): given})


def test_the_page_shows_every_parameter():
    page = parameter_page()
    for settings in SETTINGS:
        assert all((f'| `{ros_name(entry)}`' in page) == spec_of(entry).node
                   for entry in fields(settings))


def test_the_planners_parameters_fit_into_a_head():
    count = sum(spec_of(entry).node for settings in SETTINGS[:3] for entry in fields(settings))
    assert count <= 70
