"""A bag is run again: with its own parameters to the last digit, with others to compare."""

from __future__ import annotations

from dataclasses import fields, replace
import re

from bags import DT, paper_motion, write
from hypothesis import given, strategies as st
import numpy as np
import pytest
from rclpy.serialization import serialize_message

from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.replay_inputs import read_inputs, ticks_of_topics
from redundant_planner.core.errors import StateError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters, ros_name
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.latest_chunks import LatestChunks
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.parameter_files import RobotParameters, settings_of
from redundant_planner.io.recorded_target import RecordedTarget
from redundant_planner.io.recorded_tick import RecordedTick, TickKind
from redundant_planner.io.recording import read_recording
from redundant_planner.nodes.messages import markers_of
from redundant_planner.tools.replay_bag import main as replay_bag
from redundant_planner.tools.replayed_ticks import again, differences, otherwise


@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
def test_a_live_run_with_its_ticks_is_repeated_exactly(paper_runs, tmp_path, method, capfd):
    """Topics, ages, obstacles, preview: every input of every tick is in the bag."""
    bag = paper_runs[method]
    with open_bag(bag) as opened:
        inputs = read_inputs(opened, None, '', '')
    # The arm's first state may stand alone, before the nodes have all found each other.
    assert [end > begin for begin, end, *_ in inputs.parts].count(True) == 1
    assert len(inputs.notes) == len(inputs.parts) - 1 <= 1 and len(inputs.ticks) > 500
    parameters = settings_of(PlannerParameters, inputs.values)
    assert parameters.method == method
    replay = again(inputs, parameters)
    assert np.abs(replay.velocities).max() > 0.01
    found = differences(inputs, replay)
    assert len(found) > 500 and found.max() < 1e-9
    assert replay_bag([str(bag), '--out', str(tmp_path / 'again')]) == 0
    said = re.search(r'largest difference (\S+)\n', capfd.readouterr().out)
    assert said and float(said[1]) < 1e-9  # round-off, of processes that place arrays differently


def test_a_recorder_may_have_begun_before_the_planner(paper_runs):
    """What it alone heard is no input: here boxes where the tip is."""
    with open_bag(paper_runs['dynamic_factor']) as opened:
        inputs = read_inputs(opened, None, '', '')
    parameters = settings_of(PlannerParameters, inputs.values)
    tip = inputs.robot.kinematics(inputs.ticks[0][1].q).tip_position
    inputs.obstacles[0][:0] = [(0.0, bytes(serialize_message(markers_of(
        [Obstacle.box(f'unheard{i}', tip + [0.0, 0.0, 0.1 * i], [0.1] * 3)],
        inputs.robot.base_frame)))) for i in range(3)]
    # Within a process a message has no zeros at its end that it has between two.
    inputs.obstacles[0] = [(at, raw + bytes(3)) for at, raw in inputs.obstacles[0]]
    found = differences(inputs, again(inputs, parameters))
    assert len(found) > 500 and found.max() < 1e-9


def test_ticks_made_up_take_a_preview_from_its_stamp_on(paper_runs):
    """Which lies a second after its announcement."""
    with open_bag(paper_runs['variational']) as opened:
        inputs = read_inputs(opened, None, '', '')
    recorded, made_up = ([time - tick.preview_elapsed for time, tick in ticks
                          if tick.preview_elapsed > 0.0]
                         for ticks in (inputs.ticks, ticks_of_topics(inputs)))
    arrival, begin, _ = inputs.previews[0]
    assert begin > arrival + 0.5
    np.testing.assert_allclose(made_up, np.median(recorded), atol=0.02)


def test_without_ticks_the_motion_is_simulated_from_the_first_state(tmp_path):
    robot, parameters, motion = paper_motion()
    path = write(tmp_path / 'run', robot, parameters, motion)
    with open_bag(path) as opened:
        replay = otherwise(read_inputs(opened, None, '', ''), parameters)
    count = len(replay.velocities)
    assert count == pytest.approx(len(motion.velocities), abs=2)
    np.testing.assert_allclose(replay.positions, motion.positions[:count], atol=1e-9)


def test_another_method_makes_another_bag_that_can_be_compared(tmp_path, capsys):
    path = write(tmp_path / 'run', *paper_motion())
    assert replay_bag([str(path), '--method', 'gradient_projection']) == 0
    assert "'gradient_projection' from the first joint state on" in capsys.readouterr().out
    other = analyse(tmp_path / 'run_replay')
    base = analyse(path)
    assert other.robot is not None and other.joint_names == base.joint_names
    assert other.clearance is not None and other.clearance.level > 0.0
    assert np.nanmax(other.curves.path_error) < 1e-3
    assert not np.allclose(other.joints.path, base.joints.path, atol=1e-4)
    assert other.periods.median == pytest.approx(DT, abs=1e-6)
    # The new bag says what it was made with, and is a recording like any other.
    with open_bag(tmp_path / 'run_replay') as opened:
        values = read_inputs(opened, None, '', '').values
    assert values['method'] == 'gradient_projection'
    assert len(read_recording(tmp_path / 'run_replay').twists) > 10


def test_a_parameter_file_changes_some(tmp_path):
    path = write(tmp_path / 'run', *paper_motion(0.2))
    file = tmp_path / 'slow.yaml'
    file.write_text('/**: {ros__parameters: {limits.linear_speed: 0.01}}')
    assert replay_bag([str(path), '--params', str(file), '--out', str(tmp_path / 'slow')]) == 0
    slow, fast = analyse(tmp_path / 'slow'), analyse(path)
    assert slow.joints.path.sum() < 0.5 * fast.joints.path.sum()


def test_a_parameter_file_changes_no_others_and_the_new_bag_says_so(tmp_path):
    robot, parameters, motion = paper_motion(0.1)
    recorded = replace(parameters, criteria_k_w=3.0, path_priority='strict')
    path = write(tmp_path / 'run', robot, recorded, motion)
    file = tmp_path / 'slow.yaml'
    file.write_text(
        '/**: {ros__parameters: {limits: {linear_speed: 0.01}, horizon.duration: 2.0}}')
    assert replay_bag([str(path), '--params', str(file)]) == 0
    with open_bag(tmp_path / 'run_replay') as opened:
        values = read_inputs(opened, None, '', '').values
    assert settings_of(PlannerParameters, values) == replace(
        recorded, limits_linear_speed=0.01, horizon_duration=2.0)
    names = {ros_name(entry) for settings in (
        PlannerParameters, RobotParameters, PlannerNodeParameters) for entry in fields(settings)}
    assert set(values) <= {*names, 'capsule', 'static_obstacle'}


def test_what_cannot_be_replayed_is_said_in_one_line(tmp_path, capsys):
    path = write(tmp_path / 'run', *paper_motion(0.1))
    bare = write(tmp_path / 'bare', *paper_motion(0.1), ('joint_states',))
    stateless = write(tmp_path / 'stateless', *paper_motion(0.1), (
        'joint_command', 'planner_node/configuration'))
    short = write(tmp_path / 'short', *paper_motion(DT))
    (tmp_path / 'bad.yaml').write_text('/**: {ros__parameters: {criteria: {k_alpha: much}}}')
    for arguments, message in (
            ([bare], 'no robot'), ([short], 'too short'),
            ([stateless], 'no messages on joint_states'),
            ([tmp_path / 'gone'], 'no such file'), ([path, '--out', path], 'exists already'),
            ([path, '--out', tmp_path / 'bad.yaml' / 'out'], 'bad.yaml'),
            ([path, '--params', tmp_path / 'no.yaml'], 'is not a file'),
            ([path, '--params', tmp_path / 'bad.yaml'], "'criteria.k_alpha' is 'much'")):
        assert replay_bag([str(a) for a in arguments]) == 2
        error = capsys.readouterr().err
        assert message in error and 'Traceback' not in error, error


@pytest.mark.parametrize('pause', [3600.0, 10 * 365 * 86400.0])
def test_a_pause_parts_a_replay(tmp_path, pause):
    """Each part begins at its own first joint state, at rest, and lasts as long as it did."""
    robot, parameters, motion = paper_motion(0.2)
    whole = write(tmp_path / 'whole', robot, parameters, motion)
    later = replace(motion, times=motion.times + pause)
    path = write(tmp_path / 'parts', robot, parameters, motion, more=[later])
    with open_bag(whole) as opened:
        one = otherwise(read_inputs(opened, None, '', ''), parameters)
    with open_bag(path) as opened:
        inputs = read_inputs(opened, None, '', '')
    assert any('pauses 1 times' in note for note in inputs.notes)
    both = otherwise(inputs, parameters)
    count = len(one.times)
    assert len(both.times) == 2 * count
    for part in (slice(0, count), slice(count, None)):
        np.testing.assert_allclose(both.velocities[part], one.velocities, atol=1e-6)
    assert both.times[count] == pytest.approx(pause, abs=1.0)


def test_states_that_the_node_skips_are_skipped(tmp_path):
    robot, parameters, motion = paper_motion(0.2)
    motion.positions[7] = np.nan
    motion.positions[9, 2] = 1e308
    path = write(tmp_path / 'run', robot, parameters, motion)
    with open_bag(path) as opened:
        inputs = read_inputs(opened, None, '', '')
    assert any(note.startswith('2 messages on joint_states are left') for note in inputs.notes)
    assert np.isfinite(otherwise(inputs, parameters).velocities).all()


def test_ticks_that_are_none_are_left_out(tmp_path):
    robot, parameters, motion = paper_motion(0.2)
    sound = [RecordedTick(i, motion.times[i], TickKind.GOING_ON if i else TickKind.STARTING, 0, 0,
                          np.nan, 0, np.zeros(6), motion.positions[i]).numbers() for i in range(9)]
    sound[3] = sound[3][:-1]  # of another robot
    sound[5][2] = np.nan
    sound[6][4] = 1e300
    path = write(tmp_path / 'run', robot, parameters, motion, ticks=sound)
    with open_bag(path) as opened:
        inputs = read_inputs(opened, None, '', '')
    assert len(inputs.ticks) == 6
    assert sum('messages on ticks are left out' in note for note in inputs.notes) == 2
    assert np.isfinite(again(inputs, parameters).velocities).all()


@given(numbers=st.lists(st.floats() | st.sampled_from([0.0, 1.0, 2.0]), max_size=20)
       | st.lists(st.sampled_from([0.0, 1.0, 2.0, 10.0, np.nan]), min_size=16, max_size=17))
def test_whatever_numbers_a_tick_has_it_is_sound_or_refused(numbers):
    try:
        tick = RecordedTick.of(numbers, 3)
    except StateError as error:
        assert 'recorded tick' in str(error)
    else:
        assert np.isfinite([tick.stamp_ns, tick.time, *tick.twist, *tick.q]).all()
        assert min(tick.stamp_ns, tick.obstacle_messages, tick.preview_messages) >= 0


@pytest.mark.parametrize('velocities', [None, np.ones((3, 7))])
@pytest.mark.parametrize('topics', [(), ((3, 2**32 - 1),), ((1, 0), (0, 7), (9, 8))])
def test_a_chunk_survives_the_way_there_and_back_and_is_told_once(velocities, topics):
    here = Pose(np.array([0.1, 0.2, 0.3]), np.diag([1.0, -1.0, -1.0]))
    for chunk in (Chunk([0.0, 1.0, 3.0], np.arange(21.0).reshape(3, 7), velocities, late=0.25),
                  Chunk([0.0, 1.0], [here, here], late=-0.5), Chunk([2.0], np.zeros((1, 7)))):
        tick = RecordedTick(10, 1.0, TickKind.TRYING, 0, 0, np.nan, 0, np.zeros(6), np.ones(7),
                            chunk, topics)
        found = RecordedTick.of(tick.numbers(), 7)
        assert isinstance(found.target, Chunk) and not found.goes_on
        assert (found.kind, found.checked_messages) == (TickKind.TRYING, topics)
        assert found.target.late == chunk.late
        np.testing.assert_array_equal(found.target.times, chunk.times)
        if chunk.of_poses:
            np.testing.assert_array_equal(found.target.points[1].rotation, here.rotation)
            np.testing.assert_array_equal(found.target.points[1].position, here.position)
        else:
            np.testing.assert_array_equal(found.target.points, chunk.points)
            np.testing.assert_array_equal(found.target.velocities, chunk.velocities)
        np.testing.assert_array_equal(found.q, tick.q)
        spoiled = tick.numbers()
        spoiled[-1 - 2 * len(topics) - 2] = 4.0  # as if it had more points
        with pytest.raises(StateError):
            RecordedTick.of(spoiled, 7)
    further = RecordedTick.of(tick._replace(target=None, goes_on=True).numbers(), 7)
    assert further.goes_on and further.target is None
    assert (further.kind, further.checked_messages) == (TickKind.TRYING, topics)
    np.testing.assert_array_equal(further.q, tick.q)


@pytest.mark.parametrize('target', [
    None, np.arange(7.0), Pose(np.array([0.1, 0.2, 0.3]), np.diag([1.0, -1.0, -1.0]))])
@pytest.mark.parametrize('topics', [(), ((3, 2**32 - 1),), ((1, 0), (0, 7), (9, 8))])
@pytest.mark.parametrize('ages', [(), (None,), (0.2, None, 1e9)])
def test_every_kind_of_target_survives_the_way_there_and_back(target, topics, ages):
    news = tuple(Sighting(target, age) for age in ages) if target is not None else ()
    tick = RecordedTick(10, 1.0, TickKind.GOING_ON, 0, 0, np.nan, 0, np.zeros(6), np.ones(7),
                        target, topics, news=news)
    found = RecordedTick.of(tick.numbers(), 7)
    assert type(found.target) is type(target) and found.kind is TickKind.GOING_ON
    assert found.checked_messages == topics
    assert [seen.age for seen in found.news] == [seen.age for seen in news]
    for seen in found.news:
        assert all(map(np.array_equal, seen.target, target))
    one, other = (given if isinstance(given, Pose) else (given,)
                  for given in (found.target, target))
    for part, wanted in zip(one, other, strict=True):
        np.testing.assert_array_equal(part, wanted)
    np.testing.assert_array_equal(found.q, tick.q)
    if target is not None and not topics:
        spoiled = tick.numbers()
        spoiled[-1] = np.nan
        with pytest.raises(StateError):
            RecordedTick.of(spoiled, 7)


POSE = Pose(np.array([0.1, 0.2, 0.3]), np.diag([1.0, -1.0, -1.0]))
CHUNKS = [Chunk(np.arange(1.0, count + 1.0), [POSE] * count, late=0.25) for count in (1, 3)]


@pytest.mark.parametrize('targets', [
    (POSE, None), (CHUNKS[0], None), (POSE, CHUNKS[1]), CHUNKS, (None, CHUNKS[1])])
@pytest.mark.parametrize('ages', [(), (0.2, None)])
def test_targets_of_tips_survive_the_way_there_and_back(targets, ages):
    written, read = LatestChunks(), LatestChunks()
    given, found = dict(zip(('left', 'right'), targets)), []
    news = tuple(Sighting({'left': POSE}, age) for age in ages) if POSE in targets[:1] else ()
    for _ in range(2):
        aimed = written.to_record(given)
        tick = RecordedTick(10, 1.0, TickKind.GOING_ON, 0, 0, np.nan, 0, np.zeros((2, 6)),
                            np.ones(7), aimed.target, ((3, 4),), news=news,
                            tips_go_on=aimed.tips_go_on)
        back = RecordedTick.of(tick.numbers(), 7, ('left', 'right'))
        assert [seen.age for seen in back.news] == [seen.age for seen in news]
        found.append((len(tick.numbers()), read.recorded(
            RecordedTarget(back.target, back.goes_on, back.news, back.tips_go_on))))
    (size, first), (again_size, second) = found
    # Each chunk is written once, and what has not changed stays the same object.
    chunked = any(isinstance(target, Chunk) for target in targets)
    assert (again_size < size) == chunked and (first is second) == (not news)
    for tip, target in given.items():
        if isinstance(target, Chunk):
            assert first[tip] is second[tip] and first[tip].late == target.late
            np.testing.assert_array_equal(first[tip].times, target.times)
            assert all(map(np.array_equal, first[tip].end, target.end))
        elif target is None:
            assert first[tip] is None and second[tip] is None
        else:
            assert all(map(np.array_equal, second[tip], target))


def test_a_recorded_tick_survives_the_way_there_and_back_and_nonsense_is_refused():
    tick = RecordedTick(1_795_276_822_763_012_348, 12.5, TickKind.STARTING, 3, 1, np.nan,
                        5, np.arange(6.0), np.arange(7.0))
    for missed in (1, 25, 999):
        late = tick._replace(missed=missed, checked_messages=((3, 17),))
        assert RecordedTick.of(late.numbers(), 7)[-1] == missed
        assert RecordedTick.of(late.numbers(), 7).checked_messages == late.checked_messages
    numbers = tick.numbers()
    again_ = RecordedTick.of(numbers, 7)
    assert again_.missed == 0
    assert again_[:5] == tick[:5] and np.isnan(again_.preview_elapsed)
    assert again_.attached_messages == 5
    np.testing.assert_array_equal(again_.twist, tick.twist)
    np.testing.assert_array_equal(again_.q, tick.q)
    # As 0.1.0 wrote it, without the count of messages on `attached`.
    earlier = [*numbers[:3], float(tick.kind), *numbers[4:7], *numbers[8:]]
    old = RecordedTick.of(earlier, 7)
    assert old.attached_messages == 0 and old.kind is TickKind.STARTING
    np.testing.assert_array_equal(old.q, tick.q)
    for bad in (numbers[:5], numbers[:-1], earlier[:-1]):
        with pytest.raises(StateError, match=f'has {len(bad)}|robot with 7 joints'):
            RecordedTick.of(bad, 7)
    numbers[3] = 19.0
    with pytest.raises(StateError, match='of kind 9'):
        RecordedTick.of(numbers, 7)
