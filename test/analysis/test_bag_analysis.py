"""What is measured in a bag is what the run that made it computed."""

from __future__ import annotations

import csv
from dataclasses import replace
import json

from bags import KINDS, ns, paper_motion, SCENARIO, write
from conftest import PANDA_URDF
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rich.cells import cell_len
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState

from redundant_planner.analysis import metrics
from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.measure_tables import reductions
from redundant_planner.analysis.metrics import reduction
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.io.bag_reader import Event, open_bag
from redundant_planner.io.bag_repair import repair
from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.tools.analyze_bag import comparison_table, joint_table, main as analyze_bag


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    robot, parameters, motion = paper_motion()
    return write(tmp_path_factory.mktemp('bags') / 'run', robot, parameters, motion), robot, motion


def test_the_measures_are_those_of_the_run(recorded):
    path, robot, motion = recorded
    found = analyse(path)
    q, dq, count = motion.positions[:-1], motion.velocities, len(motion.velocities)
    assert found.joint_names == robot.joint_names and found.samples == count
    assert found.notes == ()
    joints = found.joints
    np.testing.assert_allclose(joints.displacement, np.abs(q[-1] - q[0]), atol=1e-9)
    np.testing.assert_allclose(joints.path, metrics.joint_path(q), atol=1e-9)
    assert joints.effort.sum() == pytest.approx(
        metrics.effort(dq, 0.004 * np.arange(count)), rel=1e-6)
    np.testing.assert_allclose(joints.peak_velocity, np.abs(dq).max(axis=0), atol=1e-12)
    np.testing.assert_allclose(joints.initial_velocity, np.abs(dq[0]), atol=1e-12)
    np.testing.assert_allclose(joints.velocity_change, np.abs(dq[-1] - dq[0]), atol=1e-12)
    ddq = np.diff(dq, axis=0) / 0.004
    np.testing.assert_allclose(joints.peak_acceleration, np.abs(ddq).max(axis=0), rtol=1e-3)
    np.testing.assert_allclose(
        joints.acceleration_change, np.abs(ddq[-1] - ddq[0]), rtol=1e-3, atol=1e-4)

    expected = metrics.smallest_clearance(robot, q, SCENARIO.obstacles)
    assert found.clearance.level == pytest.approx(expected.level, abs=1e-9)
    assert found.clearance.link == expected.link and found.clearance.sample == expected.sample
    assert found.clearance.obstacle == 'ellipsoid/0'
    curves = found.curves
    np.testing.assert_allclose(curves.positions, q, atol=1e-12)
    np.testing.assert_allclose(curves.tips, metrics.tip_positions(robot, q), atol=1e-9)
    assert np.nanmax(curves.path_error) < 1e-4
    assert curves.scale[-1] == pytest.approx(motion.results[-1].scale, abs=1e-2)
    assert found.periods.median == pytest.approx(0.004, abs=1e-6)


def test_a_command_that_fades_away_has_no_share_that_the_arm_follows(recorded, tmp_path):
    """The arm is still braking when hardly anything is commanded any more."""
    _, robot, motion = recorded

    def fading(time):
        return SCENARIO.twist_at(time) * (1.0 if time < 0.8 else 1e-4)

    faded = analyse(write(tmp_path / 'bag', robot, PlannerParameters(), motion, twist_at=fading))
    scale, times = faded.curves.scale, faded.curves.times
    begin = times[0]
    assert np.isnan(scale[times > begin + 0.81]).all()
    assert np.isfinite(scale[times < begin + 0.79]).all()
    assert np.nanmin(scale) >= 0.0 and np.nanmax(scale) < 1.01


def test_a_part_is_measured_as_if_it_were_all(recorded):
    path, _, motion = recorded
    part = analyse(path, begin=0.2 - 1e-6, end=0.6 - 1e-6)
    assert part.samples == 100
    np.testing.assert_allclose(part.curves.positions, motion.positions[50:150], atol=1e-12)


def test_two_runs_are_compared_joint_by_joint(recorded, tmp_path, capsys):
    path, robot, motion = recorded
    _, parameters, other = paper_motion(method='variational')
    second = write(tmp_path / 'other', robot, parameters, other)
    out = tmp_path / 'both.json'
    assert analyze_bag([str(path), str(second), '--json', str(out)]) == 0
    content = json.loads(out.read_text())
    base, improved = (metrics.joint_path(m.positions[:-1]) for m in (motion, other))
    for i, name in enumerate(robot.joint_names):
        value = content['reductions']['other'][name]['path']
        if base[i] > 1e-9:
            assert value == pytest.approx(100.0 * (base[i] - improved[i]) / base[i], abs=1e-6)
        else:
            assert np.isnan(value)
    assert 'reductions (%)' in capsys.readouterr().out
    np.testing.assert_allclose(reduction(np.array([2.0, 0.0]), np.array([1.0, 1.0])),
                               [50.0, np.nan])


def test_an_arm_that_starts_at_rest_has_no_initial_velocity_to_reduce(recorded):
    under_way = analyse(recorded[0])
    resting = replace(under_way, joints=replace(
        under_way.joints, initial_velocity=np.full(7, 1e-8)))
    for base, is_told in ((under_way, True), (resting, False)):
        titles = [column.header for column in comparison_table(base, under_way).columns]
        assert ('initial velocity [%]' in titles) == is_told
        rows = reductions(base, under_way)
        assert np.isfinite(rows['all joints']['initial_velocity']) == is_told
        assert rows['all joints']['path'] == 0.0
    assert 'initial velocity' not in [one.header for one in joint_table(resting).columns]


def test_csv_has_the_curves(recorded, tmp_path):
    path, _, motion = recorded
    assert analyze_bag([str(path), '--csv', str(tmp_path / 'c.csv')]) == 0
    with (tmp_path / 'c.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(motion.velocities)
    assert float(rows[7]['position.theta4']) == pytest.approx(motion.positions[7, 3])
    assert float(rows[7]['distance']) > 0.0


@pytest.mark.parametrize(('storage', 'mode'), [
    *((storage, mode) for storage in ('sqlite3', 'mcap') for mode in ('none', 'file', 'message')),
    ('mcap', 'storage')])
def test_bags_of_either_storage_and_any_compression(tmp_path, storage, mode):
    """As `ros2 bag record` writes them, with nothing but joint_states."""
    types = get_typestore(Stores.ROS2_JAZZY)
    plugin = StoragePlugin.MCAP if storage == 'mcap' else StoragePlugin.SQLITE3
    writer = Writer(tmp_path / 'bag', version=9, storage_plugin=plugin)
    if mode != 'none':
        writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection('/arm/joint_states', KINDS['joint_states'],
                                           typestore=types)
        for i in range(50):
            state = JointState(name=['a', 'b'], position=[0.1 * i, -0.2 * i])
            writer.write(connection, ns(0.01 * i), serialize_message(state))
    found = analyse(tmp_path / 'bag', namespace='/arm')
    np.testing.assert_allclose(found.joints.path, [4.9, 9.8])
    # No stamps and no velocities: arrival times, and slopes between the samples.
    np.testing.assert_allclose(found.joints.peak_velocity, [10.0, 20.0], rtol=1e-6)
    assert any('no robot' in note for note in found.notes)
    with pytest.raises(RecordingError, match="no topics in namespace 'leg'"):
        analyse(tmp_path / 'bag', namespace='leg')


def test_a_bag_whose_recorder_was_killed_is_read_as_far_as_it_goes(recorded, tmp_path):
    path, *_ = recorded
    whole = next(path.glob('*.mcap')).read_bytes()
    folder = tmp_path / 'killed'
    folder.mkdir()
    file = folder / 'killed_0.mcap'
    # In the middle of the chunk of messages, without index and metadata.
    file.write_bytes(whole[:-len(whole) // 50])
    found = analyse(folder)
    assert any('was not closed' in note for note in found.notes)
    assert found.samples > 200
    before = file.read_bytes()
    assert before == whole[:-len(whole) // 50]
    assert repair(folder) and not repair(folder)
    assert analyse(file).notes == ()


@pytest.mark.parametrize(('topics', 'note'), [
    (('joint_states',), 'no robot'),
    (('joint_states', 'planner_node/configuration'), 'no cmd_vel'),
    (('joint_command', 'planner_node/configuration'), 'no joint_states: the commanded motion')])
def test_what_is_missing_is_said_and_the_rest_is_shown(tmp_path, topics, note, capsys):
    path = write(tmp_path / 'part', *paper_motion(0.2), topics)
    assert analyze_bag([str(path), '--json', str(tmp_path / 'a.json')]) == 0
    assert note in capsys.readouterr().out.replace('\n', ' ')
    content = json.loads((tmp_path / 'a.json').read_text())['bags'][0]
    assert content['joints']['theta4']['path'] > 0.0


def test_bad_bags_end_in_one_line(recorded, tmp_path, capsys):
    path, *_ = recorded
    empty = tmp_path / 'empty'
    with BagWriter(empty) as bag:
        bag.add_topic('/joint_states', KINDS['joint_states'])
    wrong = tmp_path / 'wrong'
    with BagWriter(wrong) as bag:
        bag.add_topic('/joint_states', KINDS['cmd_vel'])
        bag.write_twist('/joint_states', ns(0.0), np.zeros(6))
    garbage = tmp_path / 'garbage.mcap'
    garbage.write_bytes(b'no bag at all' * 100)
    other = tmp_path / 'other'
    other.mkdir()
    strange = tmp_path / 'strange'
    with BagWriter(strange) as bag:
        bag.add_topic('/cmd_vel', KINDS['cmd_vel'])
        bag.write_twist('/cmd_vel', ns(0.0), np.zeros(6))
    for bag, message in ((empty, 'holds no messages'), (garbage, 'not a readable bag'),
                         (other, 'not a readable bag'), (tmp_path / 'gone', 'no such file'),
                         (strange, 'neither joint_states nor joint_command'),
                         (wrong, "'/joint_states' is geometry_msgs/msg/Twist")):
        assert analyze_bag([str(bag)]) == 2
        error = capsys.readouterr().err
        assert message in error and 'Traceback' not in error, error
    for arguments, message in ((['--urdf', '/no.urdf'], 'is not a file'),
                               (['--params', '/no.yaml'], 'is not a file'),
                               (['--urdf', str(PANDA_URDF)], 'were not recorded'),
                               (['--begin', '3', '--end', '2'], 'must lie before'),
                               (['--begin', '300'], 'has no joint_states between')):
        assert analyze_bag([str(path), *arguments]) == 2
        assert message in capsys.readouterr().err


def test_time_that_goes_backwards_and_strange_numbers_are_mentioned(tmp_path):
    path = tmp_path / 'odd'
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', KINDS['joint_states'])
        for i, stamp in enumerate((0.0, 0.01, 0.005, 0.02, 0.03)):
            state = JointState(name=['a'], position=[0.1 * i], velocity=[1.0])
            state.header.stamp.sec = ns(stamp) // 10**9
            state.header.stamp.nanosec = ns(stamp) % 10**9
            bag.write('/joint_states', ns(0.01 * i), serialize_message(state))
        bad = JointState(name=['a'], position=[np.nan], velocity=[1.0])
        bag.write('/joint_states', ns(0.05), serialize_message(bad))
        bag.write('/joint_states', ns(0.06), serialize_message(
            JointState(name=['b'], position=[1.0], velocity=[1.0])))
    notes = ' '.join(analyse(path).notes)
    left_out = '1 messages on joint_states are left out: they'
    for what in ('time goes backwards 1 times', f'{left_out} have positions that are not finite',
                 f'{left_out} are of other joints'):
        assert what in notes


def test_reading_does_not_hold_the_bag(recorded):
    """Chunks end where the order counts, and otherwise only when they are full."""
    path, *_ = recorded
    with open_bag(path) as bag:
        assert bag.topics['joint_states'] == 250
        sizes = [len(item.stamps) for item in bag.read(('joint_states', 'cmd_vel'), order=())
                 if hasattr(item, 'stamps')]
        assert sizes == [250]
        sizes = [len(item.stamps) for item in bag.read(('joint_states', 'cmd_vel'))
                 if hasattr(item, 'stamps')]
        assert max(sizes) == 1


def write_states(path, positions, times, names=('a',)):
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', KINDS['joint_states'])
        for time, q in zip(times, positions):
            bag.write_joints('/joint_states', ns(time), names, np.full(len(names), q),
                             np.full(len(names), 0.5))
    return path


def test_numbers_that_only_overflow_are_left_out_as_the_node_leaves_out_nan(tmp_path):
    q = [0.0, 0.1, 1e308, 0.2, -1e308, np.inf, 0.3]
    found = analyse(write_states(tmp_path / 'huge', q, 0.01 * np.arange(7)))
    assert found.samples == 4 and found.notes[-1].startswith('3 messages on joint_states are')
    np.testing.assert_allclose(found.joints.path, [0.3])
    assert all(np.isfinite(value).all() for value in vars(found.joints).values())


@pytest.mark.parametrize('pause', [3600.0, 10 * 365 * 86400.0])
def test_a_pause_counts_for_nothing_but_is_mentioned(tmp_path, pause):
    times = np.concatenate((0.01 * np.arange(10), pause + 0.01 * np.arange(10)))
    found = analyse(write_states(tmp_path / 'long', 0.005 * np.arange(20), times))
    np.testing.assert_allclose(found.joints.effort, 18 * 0.01 * 0.25, rtol=1e-3)
    assert any('pauses 1 times' in note for note in found.notes)


def configured(path, text):
    """A bag of the paper's arm whose configuration is a text."""
    _, _, motion = paper_motion(0.05)
    with BagWriter(path) as bag:
        for topic in ('joint_states', 'planner_node/configuration'):
            bag.add_topic(f'/{topic}', KINDS[topic])
        bag.write_text('/planner_node/configuration', ns(0.0), text)
        for i, dq in enumerate(motion.velocities):
            bag.write_joints('/joint_states', ns(motion.times[i]),
                             ('d1', 'd2', *(f'theta{k}' for k in range(3, 8))),
                             motion.positions[i], dq)
    return path


BOMB = 'a: &a [x, x]\n' + ''.join(
    f'{chr(98 + i)}: &{chr(98 + i)} [{", ".join(["*" + chr(97 + i)] * 9)}]\n' for i in range(20))


@pytest.mark.parametrize('text', [
    '{', '- 1', 'null', '[' * 3000, '&a [*a]', '2020-13-45', '9' * 6000, BOMB, 'x' * 3_000_000,
    '/**: {ros__parameters: {1: 2}}',
    '/**: {ros__parameters: {tip_frame: tip, robot_description: <robot/>}}',
    '/**: {ros__parameters: {tip_frame: [3], robot_description: 5}}',
    '/**: {ros__parameters: {capsules: [a], capsule: 3, tip_frame: tip}}'])
def test_an_unusable_configuration_costs_the_robot_and_no_more(tmp_path, text):
    found = analyse(configured(tmp_path / 'bag', text))
    assert found.robot is None and found.samples > 10
    assert any('unusable' in note for note in found.notes)
    assert all(len(note) < 3000 and note.isprintable() for note in found.notes)


def test_unusable_static_obstacles_and_another_arm_are_mentioned(recorded, tmp_path):
    path, robot, _ = recorded
    with open_bag(path) as bag:
        text = next(item.message.data for item in bag.read(['configuration']))
    found = analyse(configured(tmp_path / 'static', text.replace(
        'static_obstacle: {}', 'static_obstacle: {post: [1, 2]}')))
    assert found.robot is not None
    assert any('static obstacles' in note and 'unusable' in note for note in found.notes)
    found = analyse(configured(tmp_path / 'other', text.replace('theta7', 'elsewhere')))
    assert found.robot is None and found.joint_names == robot.joint_names
    assert any("joints ['elsewhere'] were not recorded" in note for note in found.notes)


def test_twists_and_factors_that_are_no_numbers_are_left_out(tmp_path):
    path = tmp_path / 'odd'
    with BagWriter(path) as bag:
        for topic in ('joint_states', 'cmd_vel'):
            bag.add_topic(f'/{topic}', KINDS[topic])
        bag.add_topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        bag.write_twist('/cmd_vel', ns(0.0), np.full(6, np.nan))
        bag.write_twist('/cmd_vel', ns(0.0), np.full(6, 1e300))
        bag.write('/cmd_vel', ns(0.0), b'\x00\x01')
        for i, value in enumerate(('0.5', 'nan', 'much')):
            bag.write('/diagnostics', ns(0.01 * i), serialize_message(DiagnosticArray(
                status=[DiagnosticStatus(values=[KeyValue(key='factor k', value=value)])])))
            bag.write_joints('/joint_states', ns(0.01 * i), ('a',), np.zeros(1), np.zeros(1))
    found = analyse(path)
    np.testing.assert_array_equal(found.factor[:, 1], [0.5])
    notes = ' '.join(found.notes)
    assert '2 messages on cmd_vel are left out: they have numbers' in notes
    assert '1 messages on cmd_vel are left out: they cannot be decoded' in notes


def test_what_the_planner_reported_as_an_error_is_said_once_with_its_time(tmp_path):
    path = tmp_path / 'astray'
    said = [(DiagnosticStatus.OK, 'planning', 'planner'),
            *((DiagnosticStatus.ERROR, f"does not follow: joint 'a' by 0.{i}", 'planner')
              for i in range(1, 4)),
            (DiagnosticStatus.ERROR, 'no power', 'battery'),
            (DiagnosticStatus.WARN, 'paused', 'planner')]
    with BagWriter(path) as bag:
        bag.add_topic('/joint_states', KINDS['joint_states'])
        bag.add_topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
        for i, (level, message, who) in enumerate(said):
            bag.write('/diagnostics', ns(0.2 * i), serialize_message(DiagnosticArray(
                status=[DiagnosticStatus(level=level, name=f'/left/{who}: {who}',
                                         message=message)])))
            bag.write_joints('/joint_states', ns(0.2 * i), ('a',), np.zeros(1), np.zeros(1))
    notes = [note for note in analyse(path).notes if 'error' in note]
    assert notes == ["from 0.2 to 0.6 s the planner reported an error: does not follow: joint 'a' "
                     'by 0.1']


@pytest.mark.parametrize(('names', 'reason'), [
    ((), 'they name no joint'), (tuple(map(str, range(300))), 'they name 300 joints'),
    (('\x1b[2J',), 'their joint names are no text'),
    (('a' * 9000,), 'a name in it has 9000 bytes')])
def test_joint_states_that_name_no_joints_are_left_out(tmp_path, names, reason):
    with pytest.raises(RecordingError, match=reason):
        analyse(write_states(tmp_path / 'bag', [0.0], [0.0], names))


@pytest.mark.first_alone
@pytest.mark.parametrize('name', ['[/]', '[red]x', '$x^{$', ':smile:', '_hidden', '<b>'])
def test_a_name_is_no_markup(tmp_path, name, capsys):
    folder = name.replace('/', '|')
    path = write_states(tmp_path / folder, [0.0, 0.1], [0.0, 0.1], (name,))
    assert analyze_bag([str(path), '--report', str(tmp_path / 'report')]) == 0
    shown = capsys.readouterr().out
    assert f' {name} ' in shown and f"'{folder}'" in shown


def test_what_cannot_be_written_is_said_in_one_line(recorded, tmp_path, capsys):
    path, *_ = recorded
    (tmp_path / 'file').touch()
    inside = str(tmp_path / 'file' / 'out')
    for arguments in (['--json', inside], ['--csv', inside], ['--report', inside]):
        assert analyze_bag([str(path), *arguments]) == 2
        error = capsys.readouterr().err
        assert inside in error and len(error.splitlines()) == 1
    for arguments in (['--begin', 'nan'], ['--end', 'nan'], ['--end=-inf'],
                      ['--begin', '1e300'], ['--begin=-inf', '--end=-1e300']):
        assert analyze_bag([str(path), *arguments]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_tip_on_its_way_to_a_target_has_no_path_that_it_could_leave(tmp_path):
    robot, parameters, motion = paper_motion(1.0)
    path = write(tmp_path / 'bag', robot, parameters, motion,
                 twist_at=lambda time: SCENARIO.twist_at(time) * (time < 0.4))
    whole = analyse(path)
    # Nothing is commanded from 0.4 s on, and the arm goes on: it leaves where the path ended.
    assert np.nanmax(whole.curves.path_error) > 0.005
    with BagWriter(tmp_path / 'with target') as bag, open_bag(path) as before:
        kinds = KINDS | {'target_joints': KINDS['joint_states']}
        for topic in kinds:
            bag.add_topic(f'/{topic}', kinds[topic])
        topics = {'configuration': 'planner_node/configuration'}
        for item in before.read(('cmd_vel', 'obstacles', 'configuration')):
            assert isinstance(item, Event)
            bag.write(f'/{topics.get(item.topic, item.topic)}', ns(item.arrival), item.raw)
        bag.write_joints('/target_joints', ns(0.41), robot.joint_names, motion.positions[-1],
                         np.zeros(robot.n))
        for i, dq in enumerate(motion.velocities):
            bag.write_joints('/joint_states', ns(motion.times[i]), robot.joint_names,
                             motion.positions[i], dq)
    curves = analyse(tmp_path / 'with target').curves
    begin = curves.times[0]
    assert np.nanmax(curves.path_error) < 1e-3
    assert np.isnan(curves.path_error[curves.times > begin + 0.42]).all()
    assert np.isfinite(curves.path_error[curves.times < begin + 0.4]).all()


@pytest.mark.parametrize('bags', [1, 2])
def test_what_is_printed_is_at_most_100_columns_wide_with_a_unit_for_each(
        recorded, tmp_path, bags, capsys):
    path, robot, motion = recorded
    with BagWriter(tmp_path / 'long names') as bag:
        bag.add_topic('/joint_states', KINDS['joint_states'])
        names = [f'left_arm_of_the_cell_joint_{i}' for i in range(7)]
        for i, dq in enumerate(motion.velocities):
            bag.write_joints('/joint_states', ns(0.004 * i), names, motion.positions[i], dq)
    paths = [str(path)] if bags == 1 else [str(path), str(path)]
    for arguments in (paths, [str(tmp_path / 'long names')]):
        assert analyze_bag(arguments) == 0
        printed = capsys.readouterr().out
        assert max(map(cell_len, printed.splitlines())) <= 100
        assert '…' not in printed
    assert analyze_bag(paths) == 0
    printed = capsys.readouterr().out
    for unit in ('rad²/s', 'm²/s', 'rad/s³', 'm/s³', 'mm', 'ms'):
        assert unit in printed, unit
    for name in robot.joint_names:
        assert f' {name} ' in printed
