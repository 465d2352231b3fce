"""Scenario and parameter files, good and bad."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.core.errors import ParameterError, PlannerError, ScenarioError
from redundant_planner.resources import resolve, share_directory
from redundant_planner.robot_parameters import load_robot, read_parameter_file
from redundant_planner.scenario import load_scenario

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


@pytest.mark.parametrize(('text', 'message'), [
    ('{', 'not valid YAML'), ('a: 1', 'is not a parameter file'),
    ('/**: {ros__parameters: {urdf: ""}}', "gives no robot: set 'urdf'"),
])
def test_bad_parameter_files_are_refused(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(ParameterError, match=message):
        load_robot(path)


def test_locations(tmp_path):
    with pytest.raises(PlannerError, match="package 'nowhere' is not installed"):
        resolve('package://nowhere/file.urdf')
    assert resolve('package://redundant_planner/package.xml').is_file()
    path = written(tmp_path, 'x')
    assert resolve(f'file://{path}') == path
    assert resolve('scenario.yaml', tmp_path) == path


def test_planner_files_name_only_parameters_that_exist():
    from dataclasses import fields

    from redundant_planner.core.parameters import PlannerParameters
    from redundant_planner.nodes.ros_parameters import PlannerNodeParameters
    known = {f.name for f in (*fields(PlannerParameters), *fields(PlannerNodeParameters))}
    for path in (share_directory() / 'config' / 'planner').glob('*.yaml'):
        values = read_parameter_file(path)
        assert set(values) <= known, path
        PlannerParameters(**{k: v for k, v in values.items()
                             if k in {f.name for f in fields(PlannerParameters)}})


@pytest.mark.parametrize('interpolation', ['linear', 'hold'])
def test_the_preview_of_a_profile_is_the_profile(tmp_path, interpolation):
    scenario = load_scenario(written(
        tmp_path, GOOD.replace('interpolation: linear', f'interpolation: {interpolation}')))
    times = np.array([-0.1, 0.0, 0.5, 0.999, 1.0, 1.7, 2.999, 3.0, 5.0])
    np.testing.assert_allclose(scenario.preview().at(times),
                               [scenario.twist_at(t) for t in times], atol=1e-12)
