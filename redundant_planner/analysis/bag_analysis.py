"""What a bag tells of a motion: measures per joint, of the tool and of the clearance."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis import metrics
from redundant_planner.analysis.bounded_series import HeldTwists, KeptScenes, ThinnedRows
from redundant_planner.analysis.chunk_following import ChunkLog, ChunkRun
from redundant_planner.analysis.commanded import Commands
from redundant_planner.analysis.joint_measures import JointSums
from redundant_planner.analysis.path_errors import path_errors
from redundant_planner.analysis.planner_reports import PlannerReports
from redundant_planner.analysis.results import Analysis, Curves
from redundant_planner.analysis.robot_of_bag import robot_of_bag, RobotOfBag
from redundant_planner.analysis.run_facts import run_facts
from redundant_planner.analysis.smallest_clearance import SmallestClearance
from redundant_planner.core.errors import ObstacleError, StateError
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.bag_reader import Bag, Event, open_bag
from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.joint_chunk import GAP, JointChunk
from redundant_planner.io.joint_chunks import ChosenJoints, JointsMissingError
from redundant_planner.io.joint_turns import Seams
from redundant_planner.io.left_out import LeftOut
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.payload import Payload
from redundant_planner.io.printable import printable
from redundant_planner.io.recorded_configuration import (
    COMMAND_TIMEOUT,
    number_of,
    obstacle_topics,
    recorded_obstacles,
)
from redundant_planner.io.recorded_inputs import as_it_is, sound_twist
from redundant_planner.io.tip_topics import OBJECT, OF_TIPS

Array = npt.NDArray[np.float64]

# A command slower than this share of the fastest one: a share of it says nothing.
_SLOW = 0.01
_CHUNKS = ('target_path', 'target_trajectory')
_TARGETS = ('target_pose', 'target_joints', *_CHUNKS)
_TOPICS = ('joint_states', 'joint_command', 'cmd_vel', 'attached', 'diagnostics', 'target',
           *_TARGETS)


def analyse(
    path: Path, *, params: Path | None = None, urdf: str = '', tip: str = '',
    namespace: str = '', begin: float = 0.0, end: float = np.inf,
    progress: Callable[[float], None] | None = None,
) -> Analysis:
    """Read a bag once and measure what it holds.

    The robot is that of `params`, of the planner's configuration in the bag, or of `urdf` or the
    bag's robot_description with `tip`. Without any, joints are measured alone.

    Args:
        path: the bag.
        params: parameter file of the robot.
        urdf: URDF file.
        tip: the end effector's link, where only a URDF is known.
        namespace: of the topics.
        begin, end: part of the bag to look at [s].
        progress: takes the share that is done.

    Raises:
        RecordingError: it is no bag, or has no joint states.
        PlannerError: the robot cannot be used.
    """
    with open_bag(path, namespace) as bag:
        notes: list[str] = []
        found = robot_of_bag(bag, params, urdf, tip, notes)
        given = params is not None or bool(urdf or tip)
        source = next((t for t in ('joint_states', 'joint_command') if bag.topics.get(t)), None)
        if source is None:
            raise RecordingError(
                f"'{path}' has neither joint_states nor joint_command; it has "
                f'{", ".join((*sorted(bag.topics), *bag.problems)) or "no topics"}')
        if source == 'joint_command':
            notes.append('no joint_states: the commanded motion is shown')
        for topic, what in (('cmd_vel', 'no commanded path, no twist scale'),
                            ('joint_command', 'no period of the commands'),
                            ('obstacles', 'no clearance to obstacles, but for static ones')):
            if not bag.topics.get(topic):
                notes.append(f'no {topic}: {what}')
        try:
            return _Motion(bag, source, found, notes).read(begin, end, progress)
        except JointsMissingError as error:
            if given:
                raise
            bag.left_out = LeftOut()
            notes.append(f'the robot of the recorded configuration is another one: {error}')
            return _Motion(bag, source, found._replace(robot=None), notes).read(
                begin, end, progress)


class _Motion:
    """The motion in a bag, collected message by message."""

    def __init__(
        self, bag: Bag, source: str, found: RobotOfBag, notes: list[str],
    ) -> None:
        """Begin with nothing read.

        Args:
            bag: open for reading.
            source: topic of the joint states.
            found: the robot and the planner's parameters, as far as they are known.
            notes: takes what is missing.
        """
        robot, values = found.robot, found.values
        self._bag, self._source, self._robot, self._notes = bag, source, robot, notes
        self._found, self._reports = found, PlannerReports()
        self._topics = bag.call(obstacle_topics(values))
        tips = robot.tips if robot is not None and len(robot.tips) > 1 else ()
        self._of_tips = bag.of_tips((*tips, OBJECT), OF_TIPS) if tips else []
        self._tracker = ObstacleSources.of(
            len(self._topics), recorded_obstacles(values, notes), (), transform=as_it_is,
            estimate_velocity=False)
        self._scenes = KeptScenes(self._tracker.scene)
        self._twists = HeldTwists(
            number_of(values, 'incoming_command_timeout', COMMAND_TIMEOUT, 10.0))
        self._clearance = SmallestClearance(robot) if robot is not None else None
        self._payload = Payload(robot) if robot is not None else None
        names, seams = ((), None) if robot is None else (robot.joint_names, Seams.of(robot))
        self._joints = ChosenJoints(source, names, bag.left_out, seams)
        self._sums, self._rows = JointSums(0), ThinnedRows(1)
        rate = number_of(values, 'rate', 0.0, 1e6)
        self._period = 1.0 / rate if rate > 0.0 else None
        self._command_joints = self._joints if source == 'joint_command' else ChosenJoints(
            'joint_command', names, bag.left_out, seams)
        self._commands: Commands | None = None
        self._periods: list[npt.NDArray[np.float32]] = []
        self._last_stamp: float | None = None
        self._chunks = ChunkLog(robot, bag.origin_ns * 1e-9) if robot is not None else None
        self._posture: Array | None = None
        self._targets: list[float] = []  # when each came [s]

    def read(
        self, begin: float, end: float, progress: Callable[[float], None] | None,
    ) -> Analysis:
        """Read the bag and return what was found; arguments as for `analyse`.

        Raises:
            RecordingError: there are no joint states between.
            JointsMissingError: they are of another robot.
        """
        for item in self._bag.read((*_TOPICS, *self._topics, *self._of_tips), begin, end, progress,
                                   order=(*self._topics, 'attached', *_CHUNKS, *self._of_tips)):
            if isinstance(item, Event):
                self._take_event(item)
                continue
            if item.topic == 'joint_command':
                self._take_stamps(item.stamps)
                commanded = self._take_commands(item)
            if item.topic == self._source:
                self._take_things(float(item.arrivals[0]))
                self._take_postures(
                    commanded if self._source == 'joint_command' else self._joints.of(item))
        self._take_postures(self._joints.rest())
        if not self._sums.samples:
            self._joints.check_found()
            raise RecordingError('; '.join((
                f"'{self._bag.path}' has no {self._source} between {begin:g} and {end:g} s",
                *self._bag.problems)))
        return self._analysis()

    def _take_event(self, event: Event) -> None:
        if event.topic == 'cmd_vel':
            twist = sound_twist(event, self._bag.left_out)
            if twist is not None:
                self._twists.add(event.arrival, twist)
                self._end_chunks(event.arrival, 'cmd_vel')
        elif event.topic in _TARGETS or event.topic in self._of_tips:
            self._take_target(event)
        elif event.topic == 'target':
            if not self._reports.add_target(event):
                self._end_chunks(event.arrival, 'the planner')
        elif event.topic in self._topics:
            self._tracker.update(
                event.raw, event.arrival, self._topics.index(event.topic))
            self._tracker.expire(event.arrival)
            self._scenes.add(event.arrival, self._tracker.scene)
        elif event.topic == 'attached':
            if self._payload is not None:
                self._payload.tracker.update(event.raw, event.arrival)
        else:
            self._reports.add(event)

    def _take_target(self, event: Event) -> None:
        self._targets.append(event.arrival)
        self._twists.end(event.arrival)
        tip, _, name = event.topic.rpartition('/')
        if name not in _CHUNKS or tip == OBJECT:
            # Whatever commands what tips hold together commands all of them.
            self._end_chunks(event.arrival, event.topic, '' if tip == OBJECT else tip)
        elif self._chunks is not None:
            try:
                self._chunks.add(event, self._posture, tip)
            except StateError as error:
                self._bag.left_out.add(event.topic, str(error))

    def _end_chunks(self, time: float, what: str, tip: str = '') -> None:
        if self._chunks is not None:
            self._chunks.end(time, what, tip)

    def _take_stamps(self, stamps: Array) -> None:
        if self._last_stamp is not None:
            stamps = np.append(self._last_stamp, stamps)
        self._periods.append(np.diff(stamps).astype(np.float32))
        self._last_stamp = float(stamps[-1])

    def _take_commands(self, chunk: JointChunk) -> JointChunk | None:
        self._command_joints.names = self._command_joints.names or self._joints.names
        chosen = self._command_joints.of(chunk)
        if chosen is None:
            return None
        if self._commands is None:
            self._commands = Commands(len(chosen.names), self._period)
        self._commands.add(chosen.stamps, chosen.positions, chosen.velocities)
        return chosen

    def _take_things(self, now: float) -> None:
        """See which obstacles there still are, and what the hand holds, at a time [s]."""
        self._tracker.expire(now)
        self._hold(now)

    def _take_postures(self, chosen: JointChunk | None) -> None:
        if chosen is None:
            return
        if not self._sums.samples:
            n = len(self._joints.names)
            self._sums, self._rows = JointSums(n), ThinnedRows(3 * n + 2)
        q = chosen.positions
        self._posture = q[-1] if len(q) else self._posture
        distance = (self._clearance.of(q, self._tracker.scene, self._sums.samples)
                    if self._clearance is not None else np.full(len(q), np.inf))
        dq, ddq = self._sums.add(chosen.stamps, q, chosen.velocities)
        self._rows.add(np.column_stack((chosen.stamps, q, dq, ddq, distance)))

    def _hold(self, now: float) -> None:
        """Count what the hand holds at a time [s] as a part of the arm, and as no obstacle."""
        payload, robot, clearance = self._payload, self._robot, self._clearance
        if payload is None or robot is None or clearance is None:
            return
        payload.tracker.expire(now)
        things = payload.changed()
        if things is None:
            return
        try:
            # Clearance is that to obstacles: which links may touch the thing does not count.
            clearance.hold(robot.holding(things))
        except ObstacleError as error:
            self._bag.left_out.add('attached', str(error))
            return
        self._tracker.hidden = payload.names
        self._scenes.add(now, self._tracker.scene)

    def _analysis(self) -> Analysis:
        sums, notes, clearance = self._sums, self._notes, self._clearance
        commands = self._commands
        if commands is not None and (
                not commands.count or self._command_joints.names != self._joints.names):
            commands = None
            notes.append('joint_command has no velocities of these joints')
        if sums.backwards:
            notes.append(
                f'time goes backwards {sums.backwards} times; those steps count for nothing')
        if sums.gaps:
            notes.append(
                f'{self._source} pauses {sums.gaps} times for more than {GAP:g} s, at most '
                f'{sums.longest_gap:.6g} s; how fast the arm was meanwhile is not known')
        if self._robot is not None and len(self._robot.tips) > 1:
            notes.append(f"the tip's curves are of '{self._robot.tip_frame}' alone; twist scale "
                         'and distance from the path of several tips are in /diagnostics')
        notes += self._reports.notes
        notes += self._bag.problems
        if commands is not None and self._period is None:
            notes.append('no rate of the planner: accelerations and jerks of the commands count '
                         "from the median of their stamps' differences")
        curves, chunks = _curves(
            self._robot, self._rows.rows(), self._twists, self._scenes.kept, commands,
            np.sort(self._targets), self._chunks)
        intervals = np.concatenate(self._periods) if self._periods else np.empty(0, np.float32)
        return Analysis(
            name=printable(self._bag.path.absolute().name), robot=self._robot,
            joint_names=self._joints.names, samples=sums.samples,
            begin=sums.begin_time, end=sums.end_time, joints=sums.measures(),
            commanded=commands.peaks if commands is not None else None,
            curves=curves,
            clearance=clearance.smallest if clearance is not None else None,
            distance=clearance.distance if clearance is not None else np.inf,
            periods=_periods(intervals), factor=self._reports.factor,
            notes=tuple(dict.fromkeys(printable(note) for note in notes)),
            facts=run_facts(
                self._found.values, self._found.software, self._bag.origin_ns,
                self._reports.tick_median, self._reports.tick_longest),
            chunks=tuple((run, printable(self._reports.word_at(run.off_at))) for run in chunks))


def _periods(intervals: npt.NDArray[np.float32]) -> metrics.Periods | None:
    if not len(intervals):
        return None
    return metrics.Periods(float(np.median(intervals)), float(np.percentile(intervals, 99)),
                           float(intervals.max()))


def _curves(
    robot: Robot | None, rows: Array, commanded: HeldTwists, scenes: list[tuple[float, Scene]],
    commands: Commands | None, targets: Array, log: ChunkLog | None,
) -> tuple[Curves, tuple[ChunkRun, ...]]:
    n = (rows.shape[1] - 2) // 3
    times, q, dq, ddq = rows[:, 0], rows[:, 1:1 + n], rows[:, 1 + n:1 + 2 * n], rows[:, -1 - n:-1]
    scale: Array = np.full(len(rows), np.nan)
    error: Array = np.full(len(rows), np.nan)
    chunks: tuple[ChunkRun, ...] = ()
    tips: Array = np.full((len(rows), 3), np.nan)
    if robot is not None:
        arms, count = robot.kinematics_along(q), len(robot.tips)
        tips, rotations = arms.tip_positions[::count], arms.tip_rotations[::count]
        if log is not None:
            chunks = log.runs(times, q, arms)
    if robot is not None and len(robot.tips) == 1:
        twists = commanded.at(times)
        task = np.array([robot.task_rows(twist) for twist in twists])
        size = (task * task).sum(axis=1)
        followed = ((arms.jacobian @ dq[:, :, None])[:, :, 0] * task).sum(axis=1)
        commanded_to_move = size > _SLOW ** 2 * size.max(initial=0.0)
        scale[commanded_to_move] = followed[commanded_to_move] / size[commanded_to_move]
        error = path_errors(robot, times, twists, tips, rotations, targets)
    told = commands.at(times) if commands is not None else None
    return Curves(
        times, q, dq, ddq, told, rows[:, -1], scale, tips, error, tuple(scenes)), chunks
