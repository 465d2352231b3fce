"""Scenario and parameter files, good and bad."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from redundant_planner.core.errors import ParameterError, PlannerError, ScenarioError
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.io.obstacle_entries import static_obstacles
from redundant_planner.io.parameter_files import (
    known_parameters,
    parameter_values,
    read_parameter_file,
    RobotParameters,
    settings_of,
)
from redundant_planner.io.recorded_configuration import configuration_of
from redundant_planner.io.resources import resolve, share_directory
from redundant_planner.io.robot_files import load_robot
from redundant_planner.io.scenario import load_scenario

SCENARIOS = sorted((share_directory() / 'config' / 'scenarios').glob('*.yaml'))
GOOD = """
robot: package://redundant_planner/config/robots/paper_2p5r.yaml
start: {d1: 0.1, d2: 0.1, theta3: 0, theta4: 0, theta5: 0, theta6: 0, theta7: 0}
interpolation: linear
twist:
  - {time: 0, linear: [0, 0, 0]}
  - {time: 1, linear: [0.1, 0, 0], angular: [0, 0, 1]}
  - {time: 3}
obstacles:
  - {name: ball, center: [1, 0, 0], semi_axes: [0.1, 0.1, 0.2]}
"""


@pytest.mark.parametrize('path', SCENARIOS, ids=lambda p: p.stem)
def test_scenarios_of_the_package_load(path):
    scenario = load_scenario(path)
    assert scenario.duration > 0.0 and scenario.robot_file.is_file() and scenario.start


def written(tmp_path, text):
    path = tmp_path / 'scenario.yaml'
    path.write_text(text)
    return path


def test_a_profile_is_interpolated_or_held(tmp_path):
    linear = load_scenario(written(tmp_path, GOOD))
    np.testing.assert_allclose(linear.twist_at(0.5), [0.05, 0, 0, 0, 0, 0.5])
    np.testing.assert_allclose(linear.twist_at(2.0), [0.05, 0, 0, 0, 0, 0.5])
    held = load_scenario(written(tmp_path, GOOD.replace('linear\n', 'hold\n')))
    np.testing.assert_allclose(held.twist_at(0.999), 0.0)
    np.testing.assert_allclose(held.twist_at(2.9), [0.1, 0, 0, 0, 0, 1])
    for scenario in (linear, held):
        np.testing.assert_array_equal(scenario.twist_at(-0.1), 0.0)
        np.testing.assert_array_equal(scenario.twist_at(3.0), 0.0)
    assert linear.obstacles[0].name == 'ball'
    np.testing.assert_array_equal(linear.start_posture(linear.load_robot())[:2], 0.1)


@pytest.mark.parametrize(('old', 'new', 'message'), [
    ('robot:', 'arm:', r"has 'arm'; it takes 'robot'"),
    ('start: {d1', 'begin: {d1', r"has 'begin'"),
    ('paper_2p5r.yaml', 'nothing.yaml', r"nothing.yaml' is not a file"),
    ('interpolation: linear', 'interpolation: cubic', r"interpolation is 'cubic'"),
    ('time: 1,', 'time: 5,', r'ascending times'),
    ('linear: [0.1, 0, 0]', 'linear: [0.1, 0]', r'scenario'),
    ('linear: [0.1, 0, 0]', 'linear: [.nan, 0, 0]', r'finite numbers'),
    ('[0.1, 0.1, 0.2]', '[0.1, 0.0, 0.2]', r"obstacle 'ball': semi_axes"),
    ('center:', 'centre:', r"obstacle 'ball' lacks 'center'"),
    ('linear: [0.1, 0, 0]', 'lineer: [0.1, 0, 0]', r"entry of twist has 'lineer'; it takes"),
    ('linear: [0.1, 0, 0]', 'linear: fast', r"linear of an entry of twist is 'fast'"),
    ('time: 1,', 'time: soon,', r"the time of an entry of twist is 'soon'"),
    ('time: 1,', '', r"an entry of twist lacks 'time'"),
    ('{time: 3}', '{time: .inf}', r'time of an entry of twist is inf'),
    ('{time: 3}', 'stop', r"an entry of twist is 'stop'"),
    ('{d1: 0.1', '{d1: .nan', r"start of joint 'd1' is nan; it takes a number"),
    ('{d1: 0.1', '{d1: left', r"start of joint 'd1' is 'left'"),
    ('interpolation: linear', 'start: [1]', r'start is \[1\]; it takes a position for each'),
    ('interpolation: linear', 'twist: {}\nold:', r"has 'old'"),
    ('package://redundant_planner/config/robots/paper_2p5r.yaml', '5', r'robot is 5; it takes'),
    ('[1, 0, 0], semi', '[[1], 0, 0], semi', r"obstacle 'ball': center is \[\[1\], 0, 0\]"),
    ('- {name: ball', '- 7\n  - {name: ball', r"obstacle 'obstacle0' is 7; it takes 'shape'"),
    (GOOD, '[1, 2]', r'is not a mapping'),
    (GOOD, '{', r'cannot be read'),
])
def test_bad_scenarios_are_refused_by_name(tmp_path, old, new, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario(written(tmp_path, GOOD.replace(old, new)))


def test_a_start_that_leaves_a_joint_out_is_refused(tmp_path):
    scenario = load_scenario(written(tmp_path, GOOD.replace('d1: 0.1, ', '')))
    with pytest.raises(ScenarioError, match="gives no start for 'd1'"):
        scenario.start_posture(scenario.load_robot())


def of_parameters(text):
    return f'/**: {{ros__parameters: {{{text}}}}}'


@pytest.mark.parametrize(('text', 'message'), [
    ('{', 'not valid YAML'), ('a: 1', 'is not a parameter file'), ('', 'is not a parameter file'),
    ('[1]', 'is not a parameter file'), ('/**: 5', 'is not a parameter file'),
    ('/**: {ros__parameters: [[a, b]]}', 'is not a parameter file'),
    ('/**: {ros__parameters: ""}', 'is not a parameter file'),
    ('[' * 5000, 'not valid YAML'), ('a: 2001-99-99', 'not valid YAML'), ('a: \x01', 'not valid'),
    (of_parameters('urdf: ""'), "gives no robot: set 'urdf'"),
    (of_parameters('urdff: a, tip_frame: b'), "'urdff' is not known; did you mean 'urdf'?"),
    (of_parameters('horizon.look_aheed: 0.0'),
     "'horizon.look_aheed' is not known; did you mean 'horizon.look_ahead'?"),
    (of_parameters('capsule: [a, b]'), r"parameter 'capsule' is \['a', 'b'\]; it must hold names"),
    (of_parameters('capsule: thick'), "parameter 'capsule' is 'thick'"),
    (of_parameters('capsule: {arm: null}'), "parameter 'capsule' is {'arm': None}"),
    (of_parameters('capsule: {arm: {}}'), "describes the capsules 'arm', which .*'capsules' does"),
    (of_parameters('capsules: [arm], tip_frame: a, robot_description: b'),
     "capsule 'arm' lacks 'frame'"),
    (of_parameters('axes: 5'), "parameter 'axes' is 5; it must be a list"),
])
def test_bad_parameter_files_are_refused(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(ParameterError, match=message):
        load_robot(path)


@pytest.mark.parametrize(('name', 'message'), [
    ('folder', 'cannot be read: Is a directory'), ('missing.yaml', 'cannot be read: No such file'),
    ('latin.yaml', 'is not UTF-8'), ('large.yaml', 'is larger than 20000000 bytes')])
def test_files_that_cannot_be_read_are_refused(tmp_path, name, message):
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'latin.yaml').write_bytes(b'\xe9')
    with (tmp_path / 'large.yaml').open('wb') as file:
        file.truncate(20_000_001)
    with pytest.raises(ParameterError, match=message):
        load_robot(tmp_path / name)
    with pytest.raises(ScenarioError, match=message):
        load_scenario(tmp_path / name)


def test_names_may_have_dots_or_be_nested_as_in_ros(tmp_path):
    nested = 'capsule: {arm: {frame: base, radius: 0.1, start: [0, 0, 0], end: [0, 0, 1]}}'
    dotted = ('capsule.arm.frame: base, capsule.arm.radius: 0.1, capsule.arm: {start: [0, 0, 0], '
              'end: [0, 0, 1]}')
    values = [read_parameter_file(written(tmp_path, of_parameters(text)))
              for text in (nested, dotted)]
    assert values[0] == values[1]


def test_files_may_hold_the_parameters_of_every_node_of_the_package(tmp_path):
    path = written(tmp_path, of_parameters(
        'use_sim_time: true, rate: 100, noise: 0.1, initial_joints: [a], settle: 1.0, '
        'criteria.k_w: 2.0, '
        'qos_overrides./tf.publisher.depth: 5'))
    assert read_parameter_file(path)['criteria.k_w'] == 2.0


def test_recorded_parameters_of_other_versions_are_read():
    values = parameter_values({'/**': {'ros__parameters': {
        'gone_since': 1, 'criteria': {'k_w': 2.0}}}}, 'bag')
    assert settings_of(PlannerParameters, values).criteria_k_w == 2.0


@pytest.mark.parametrize(('text', 'message'), [
    ('[a]', "parameter 'static_obstacle' is"), ('{ball: 5}', "parameter 'static_obstacle' is"),
    ('{ball: {center: abc, semi_axes: [1, 1, 1]}}', "obstacle 'ball': center is 'abc'"),
    ('{ball: {center: [[1], 2, 3], semi_axes: [1, 1, 1]}}', r"obstacle 'ball': center is \[\[1\]"),
    ('{ball: {center: null, semi_axes: [1, 1, 1]}}', "obstacle 'ball': center is None"),
    ('{ball: {centre: [1, 2, 3], semi_axes: [1, 1, 1]}}', "obstacle 'ball' lacks 'center'"),
])
def test_bad_static_obstacles_are_refused(text, message):
    with pytest.raises(PlannerError, match=message):
        static_obstacles({'static_obstacle': yaml.safe_load(text)})


def test_locations(tmp_path):
    with pytest.raises(PlannerError, match="package 'nowhere' is not installed"):
        resolve('package://nowhere/file.urdf')
    assert resolve('package://redundant_planner/package.xml').is_file()
    path = written(tmp_path, 'x')
    assert resolve(f'file://{path}') == path
    assert resolve('scenario.yaml', tmp_path) == path


def test_planner_files_name_only_parameters_that_exist(tmp_path):
    for path in (share_directory() / 'config' / 'planner').glob('*.yaml'):
        # One section for all nodes, or one for each arm's.
        for section in yaml.safe_load(path.read_text()).values():
            alone = tmp_path / path.name
            alone.write_text(yaml.safe_dump({'/**': section}))
            values = read_parameter_file(alone)
            assert set(values) <= set(known_parameters()), path
            settings_of(PlannerParameters, values)
            static_obstacles(values)


@pytest.mark.parametrize('entry', ['a', 'a=', '=1.0', 'a=nan', '*=other'])
def test_locked_joints_are_names_and_positions(entry):
    with pytest.raises(ParameterError, match=r"'joint=position'.* or '\*=measured'"):
        RobotParameters(locked_joints=('b=0.5', '*=measured', entry))


def test_recorded_values_may_stand_in_groups_and_be_unknown_today():
    text = """/**:
      ros__parameters: {method: variational, criteria: {k_w: 2.0}, horizon.duration: 2.5,
                        clearance_of_old: 0.02, rate: 100}"""
    notes = []
    values = configuration_of(text, notes)
    assert not notes and values['rate'] == 100
    assert settings_of(PlannerParameters, values) == PlannerParameters(
        method='variational', criteria_k_w=2.0, horizon_duration=2.5)


@pytest.mark.parametrize('interpolation', ['linear', 'hold'])
def test_the_preview_of_a_profile_is_the_profile(tmp_path, interpolation):
    scenario = load_scenario(written(
        tmp_path, GOOD.replace('interpolation: linear', f'interpolation: {interpolation}')))
    times = np.array([-0.1, 0.0, 0.5, 0.999, 1.0, 1.7, 2.999, 3.0, 5.0])
    np.testing.assert_allclose(scenario.preview().at(times),
                               [scenario.twist_at(t) for t in times], atol=1e-12)
