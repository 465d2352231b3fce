"""The report's page: the first frame, the motion alone, what is left out, and two bags."""

from __future__ import annotations

import base64
from dataclasses import replace
from html.parser import HTMLParser
import json

from bags import KINDS, ns, paper_motion, SCENARIO, write
import numpy as np
import pytest
from rclpy.serialization import serialize_message

from redundant_planner import __version__
from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.measure_tables import motion_measures
from redundant_planner.analysis.motion_interval import command_begin, shown_together
from redundant_planner.analysis.report import page_of
from redundant_planner.analysis.report_data import drawn_samples, page_data
from redundant_planner.analysis.report_numbers import difference_text, number_text
from redundant_planner.analysis.report_tables import facts_of, joint_columns, peak_columns
from redundant_planner.analysis.report_view import view_of
from redundant_planner.analysis.run_facts import run_facts
from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.parameter_files import read_robot_parameters
from redundant_planner.io.parameter_writer import parameter_file_text
from redundant_planner.io.resources import share_directory
from redundant_planner.io.software_version import with_version
from redundant_planner.nodes.messages import markers_of

REST = 2.0


def numbers(text):
    return np.frombuffer(base64.b64decode(text), dtype='<f4')


@pytest.fixture(scope='module')
def waiting(tmp_path_factory):
    """The paper's motion after a time at rest, its obstacle published as the command begins."""
    robot, parameters, motion = paper_motion(1.0)
    path = tmp_path_factory.mktemp('page') / 'waiting'
    values, _ = read_robot_parameters(
        share_directory() / 'config' / 'robots' / 'paper_2p5r.yaml')
    still = np.zeros(robot.n)
    with BagWriter(path) as bag:
        for topic, kind in KINDS.items():
            bag.add_topic(f'/{topic}', kind)
        bag.write_text('/planner_node/configuration', ns(0.0), with_version(parameter_file_text(
            values, robot, {}, parameters, PlannerNodeParameters())))
        for i in range(round(REST / 0.004)):
            bag.write_joints('/joint_states', ns(0.004 * i), robot.joint_names,
                             motion.positions[0], still)
        bag.write('/obstacles', ns(REST), serialize_message(
            markers_of(SCENARIO.obstacles, robot.base_frame)))
        for i, dq in enumerate(motion.velocities):
            at = ns(REST + motion.times[i])
            bag.write_twist('/cmd_vel', at, SCENARIO.twist_at(motion.times[i]))
            for topic in ('joint_states', 'joint_command'):
                bag.write_joints(f'/{topic}', at, robot.joint_names, motion.positions[i], dq)
    return analyse(path)


@pytest.fixture(scope='module')
def second(tmp_path_factory):
    robot, parameters, motion = paper_motion(1.0, 'variational')
    return analyse(write(tmp_path_factory.mktemp('page') / 'second', robot, parameters, motion))


def test_the_first_frame_holds_arm_obstacles_and_trail(waiting):
    view = view_of(waiting, shown_together([waiting.curves]))
    first, frames = view['first'], len(view['times'])
    assert view['times'][first] < 0.0
    chains = numbers(view['chain']).reshape(frames, -1, 3)
    np.testing.assert_allclose(
        chains[first, 1:], waiting.robot.joint_points(waiting.curves.positions[0]), atol=1e-6)
    obstacle = numbers(view['obstacles'][view['scene'][first]]).reshape(-1, 3)
    expected = SCENARIO.obstacles[0]
    np.testing.assert_allclose(obstacle.mean(axis=0), expected.center, atol=0.01)
    np.testing.assert_allclose(np.ptp(obstacle, axis=0), 2.0 * expected.half_extents, rtol=0.05)
    # The trail leads from the first frame to the end of the motion.
    trail = numbers(view['tips']).reshape(frames, 3)[first:]
    assert np.linalg.norm(trail[-1] - trail[0]) > 0.04
    # And all of it lies within the picture.
    low, high = np.transpose(view['range'])
    for points in (chains.reshape(-1, 3), obstacle, trail):
        assert (points >= low).all() and (points <= high).all()


def test_time_is_cropped_to_the_motion(waiting):
    data = page_data([waiting], [None])
    bag = data['bags'][0]
    assert command_begin(waiting.curves) == pytest.approx(REST, abs=0.005)
    np.testing.assert_allclose(bag['motion'], [0.0, 1.0], atol=0.01)
    np.testing.assert_allclose(bag['shown'], [-0.1, 0.996], atol=0.01)
    np.testing.assert_allclose(bag['whole'], [-REST, 0.996], atol=0.01)
    # Every sample of the motion is drawn, some of the time before it.
    times = numbers(bag['time'])
    assert (times >= 0.0).sum() == 250
    assert 20 < (times < -0.1).sum() < 300


def test_curves_hold_what_was_recorded_commanded_and_measured(waiting):
    data = page_data([waiting], [None])
    chosen = drawn_samples(waiting, shown_together([waiting.curves]))
    panel = next(panel for panel in data['panels']
                 if (panel['group'], panel['title']) == ('velocity', 'theta4'))
    assert panel['unit'] == 'rad/s'
    assert [limit['at'] for limit in panel['limits']] == [
        -waiting.robot.velocity_max[3], waiting.robot.velocity_max[3]]
    curves = {curve['style']: numbers(curve['values']) for curve in panel['curves']}
    np.testing.assert_allclose(curves['measured'], waiting.curves.velocities[chosen, 3],
                               atol=1e-7)
    np.testing.assert_allclose(curves['commanded'], waiting.curves.commanded[0][chosen, 3],
                               atol=1e-7)


def test_measures_of_a_motion_under_way_are_left_out_for_an_arm_at_rest(waiting, second):
    titles = [column.title for column in joint_columns(waiting)]
    assert 'initial velocity' not in titles
    # Its command ends under way.
    assert 'velocity change' in titles
    moving = replace(second, joints=replace(
        second.joints, initial_velocity=second.joints.peak_velocity))
    column = next(one for one in joint_columns(moving) if one.title == 'initial velocity')
    np.testing.assert_array_equal(column.values, second.joints.peak_velocity)
    still = np.zeros(7)
    ended = replace(second, joints=replace(
        second.joints, initial_velocity=still, velocity_change=still))
    assert [column.title for column in joint_columns(ended)] == [
        'displacement', 'path ∫|q̇|', '∫q̇²']


def test_a_part_that_begins_under_way_has_its_initial_velocity(tmp_path):
    robot, parameters, motion = paper_motion(1.0)
    bag = write(tmp_path / 'bag', robot, parameters, motion)
    part = analyse(bag, begin=0.5)
    assert 'initial velocity' in [column.title for column in joint_columns(part)]


def test_measured_accelerations_are_shown_without_commands_alone(waiting):
    groups = {(column.group, column.title) for column in peak_columns(waiting)}
    assert ('acceleration', 'commanded') in groups and ('acceleration', 'measured') not in groups
    groups = {(column.group, column.title)
              for column in peak_columns(replace(waiting, commanded=None))}
    assert groups == {('velocity', 'measured'), ('acceleration', 'measured')}


@pytest.mark.parametrize('of_targets, least', [
    ({}, 0.01), ({'target.margin': -1.0}, 0.01), ({'target.margin': 0.002}, 0.002),
    ({'target.margin': 0.5}, 0.01),
    ({'target.margin': 0.0}, None)])
def test_the_margin_is_the_least_that_was_to_be_kept(of_targets, least):
    facts = run_facts({'clearance.margin': 0.01, **of_targets}, '', 0, None, None)
    assert facts.margin == least


def test_it_says_what_was_run(waiting, second):
    facts = facts_of(waiting)
    assert facts['Robot'] == 'paper_2p5r, 7 joints' and facts['Method'] == 'dynamic_factor'
    assert facts['Recorded'] == '2023-11-14 22:13 UTC'
    assert facts['Software'].startswith(f'redundant_planner {__version__}')
    # That one's configuration does not say.
    assert facts_of(second)['Software'] == '' and facts_of(second)['Method'] == 'variational'
    assert 'not recorded' in page_of([second])


def number_of(text):
    """The number that a cell shows."""
    mantissa, _, exponent = text.replace('−', '-').partition('·10')
    raised = str.maketrans('⁰¹²³⁴⁵⁶⁷⁸⁹⁻', '0123456789-')
    return float(mantissa) * 10.0 ** int(exponent.translate(raised) or 0)


class Rows(HTMLParser):
    """Collects the cells of every row of every table."""

    def __init__(self):
        super().__init__()
        self.rows, self.inside = [], False

    def handle_starttag(self, tag, attrs):
        if tag == 'tr':
            self.rows.append([])
        if tag in ('td', 'th'):
            self.rows[-1].append('')
            self.inside = True

    def handle_endtag(self, tag):
        if tag in ('td', 'th'):
            self.inside = False

    def handle_data(self, data):
        if self.inside:
            self.rows[-1][-1] += data


def test_the_differences_of_two_bags_are_those_of_their_figures(waiting, second):
    parsed = Rows()
    parsed.feed(page_of([waiting, second]))
    rows = {row[0]: row[1:] for row in parsed.rows if row}
    a, b = motion_measures(waiting), motion_measures(second)
    for key, title, scale in (
            ('joint_path', 'Joint path, all joints', 1.0), ('effort', '∫q̇ᵀq̇ dt', 1.0),
            ('smallest_distance_mm', 'Smallest distance', 1.0),
            ('twist_scale_mean', 'Commanded twist that was followed, mean', 100.0)):
        first, other, difference, _, _ = rows[title]
        assert first == number_text(scale * a[key]) and other == number_text(scale * b[key])
        assert difference == difference_text(scale * a[key], scale * b[key])
        if difference != '±0':
            assert number_of(difference) == pytest.approx(
                scale * (b[key] - a[key]), rel=6e-3)
    found = [row for row in parsed.rows if row and row[0] == 'theta4' and row[5:] == ['rad']]
    paths = [one.joints.path[3] for one in (waiting, second)]
    assert found[0][1:4] == [*map(number_text, paths), difference_text(*paths)]
    # And the curves of both lie in the same diagrams.
    for panel in page_data([waiting, second], [None, None])['panels']:
        assert {curve['bag'] for curve in panel['curves']} == {0, 1}


def test_nan_does_not_break_the_page(waiting):
    """Where nothing is known there is no number, and the data stay JSON that a browser reads."""
    curves, holes = waiting.curves, np.arange(len(waiting.curves.times)) % 3 == 0
    told = tuple(np.where(holes[:, None], np.nan, values) for values in curves.commanded)
    broken = replace(waiting, curves=replace(
        curves, commanded=told, scale=np.full(len(holes), np.nan),
        clearance=np.full(len(holes), np.inf),
        path_error=np.where(holes, np.nan, curves.path_error)))
    data = page_data([broken], [view_of(broken, shown_together([broken.curves]))])
    json.dumps(data, allow_nan=False)
    titles = [panel['title'] for panel in data['panels'] if panel['group'] == 'arm']
    assert titles == ['Tip off its path']
    assert 'nan' not in page_of([broken]).split('<script>')[0].lower()


def test_a_bag_of_joint_states_alone_has_a_page(tmp_path):
    path = tmp_path / 'alone'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', KINDS['joint_states'])
        for i, q in enumerate((0.0, 0.1, np.nan, 0.3)):
            bag.write_joints('/joint_states', ns(0.01 * i), ('a', '</figure>'),
                             np.array([q, 0.0]), np.array([0.5, 0.0]))
    page = page_of([analyse(path)])
    head = page.split('<script>')[0]
    assert 'id="view0"' not in head and 'no robot' in head
    assert '&lt;/figure&gt;' in head and '</figure>' not in head
