"""What a bag tells of a motion: measures per joint, of the tool and of the clearance."""

from __future__ import annotations

import array
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis import metrics
from redundant_planner.core.errors import PlannerError
from redundant_planner.core.obstacles.clearance import link_clearance, pseudo_distance
from redundant_planner.core.obstacles.inflation import inflated_ellipsoids, InflatedEllipsoids
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.io.bag_files import RecordingError
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.printable import printable
from redundant_planner.io.recorded_configuration import (
    configuration_of,
    number_of,
    recorded_obstacles,
)
from redundant_planner.io.recording import (
    as_it_is,
    Bag,
    ChosenJoints,
    Event,
    GAP,
    JointsMissingError,
    LeftOut,
    open_bag,
    sound_twist,
)
from redundant_planner.io.resources import resolve
from redundant_planner.io.robot_files import build_robot, likely_tip, load_robot, robot_of_values

Array = npt.NDArray[np.float64]

# Curves are thinned out to at most this many samples, and so many numbers.
_SAMPLES = 40_000
_NUMBERS = 8_000_000
# Links × obstacles × postures that are looked at together.
_BLOCK = 2_000_000
# A command holds for this long where the bag does not say how long [s].
COMMAND_TIMEOUT = 0.1
# How many samples of the commanded path are searched for the one next to the tip.
_BEHIND, _AHEAD = 20, 400
# Radius of the straight links that stand for shapes that are not known [m].
_UNKNOWN_RADIUS = 0.05
# A measure below this is round-off, of which nothing can be a share.
_NOTHING = 1e-9
# Obstacles that are kept, all their places counted.
_OBSTACLES = 200_000


@dataclass(frozen=True)
class JointMeasures:
    """The paper's measures of every joint, (n,) each [rad, m; per s; per s²].

    Attributes:
        displacement: |q_end − q_start|.
        path: ∫|q̇| as Σ|Δq|, Eq. 10.
        effort: ∫q̇², each velocity held until the next sample.
        initial_velocity: |q̇(0)|.
        velocity_change: |q̇_end − q̇(0)|.
        acceleration_change: |q̈_end − q̈(0)|, by differences over one sample.
        peak_velocity, peak_acceleration: the largest.
    """

    displacement: Array
    path: Array
    effort: Array
    initial_velocity: Array
    velocity_change: Array
    acceleration_change: Array
    peak_velocity: Array
    peak_acceleration: Array


@dataclass(frozen=True)
class Curves:
    """The motion over time, thinned out to k samples.

    Attributes:
        times: (k,) [s].
        positions, velocities, accelerations: (k, n).
        clearance: (k,) smallest distance of a link to an obstacle, not more than the true one,
            the smallest since the sample before [m]; infinite without robot or obstacles.
        scale: (k,) share of the commanded twist that the tip followed, NaN without a command.
        tips: (k, 3) in the base frame [m], NaN without a robot.
        path_error: (k,) distance of the tip from the commanded path, NaN while there is none [m].
        scenes: times [s] from which on the obstacles stood as given.
    """

    times: Array
    positions: Array
    velocities: Array
    accelerations: Array
    clearance: Array
    scale: Array
    tips: Array
    path_error: Array
    scenes: tuple[tuple[float, Scene], ...]


@dataclass(frozen=True)
class Analysis:
    """What was found out about a bag.

    Attributes:
        name: of the bag.
        robot: of the bag, None if nothing said which.
        joint_names: n names.
        samples: of joint states.
        begin, end: of the motion, from the bag's first message [s].
        joints: measures per joint.
        curves: over time.
        clearance: the smallest level and where it was, None without robot or obstacles.
        distance: the smallest distance [m].
        periods: of joint_command, None without commands.
        factor: of `/diagnostics`, (k, 2) time and k; empty if none were recorded.
        notes: what is missing, and what could not be read.
    """

    name: str
    robot: Robot | None
    joint_names: tuple[str, ...]
    samples: int
    begin: float
    end: float
    joints: JointMeasures
    curves: Curves
    clearance: metrics.Clearance | None
    distance: float
    periods: metrics.Periods | None
    factor: Array
    notes: tuple[str, ...]


@dataclass
class _Sums:
    """Measures per joint, added up chunk by chunk."""

    n: int
    samples: int = 0
    backwards: int = 0
    gaps: int = 0
    longest_gap: float = 0.0
    start: Array = field(default_factory=lambda: np.empty(0))
    start_velocity: Array = field(default_factory=lambda: np.empty(0))
    start_acceleration: Array | None = None
    end: Array = field(default_factory=lambda: np.empty(0))
    end_velocity: Array = field(default_factory=lambda: np.empty(0))
    end_acceleration: Array | None = None
    begin_time: float = 0.0
    end_time: float = 0.0
    path: Array = field(init=False)
    effort: Array = field(init=False)
    peak_velocity: Array = field(init=False)
    peak_acceleration: Array = field(init=False)

    def __post_init__(self) -> None:
        self.path, self.effort, self.peak_velocity, self.peak_acceleration = np.zeros((4, self.n))

    def add(self, times: Array, q: Array, dq: Array) -> tuple[Array, Array]:
        """Add samples (k, n); return their velocities and accelerations (k, n)."""
        if self.samples:
            times = np.concatenate(((self.end_time,), times))
            q, dq = np.vstack((self.end, q)), np.vstack((self.end_velocity, dq))
        steps = np.diff(times)
        self.backwards += int((steps < 0.0).sum())
        gaps = steps[steps > GAP]
        self.gaps += len(gaps)
        self.longest_gap = max(self.longest_gap, float(gaps.max(initial=0.0)))
        # Of a step back, and of a gap, nobody knows how fast the arm was.
        positive = np.where(steps <= GAP, np.maximum(steps, 0.0), 0.0)[:, None]
        moves = np.diff(q, axis=0)
        with np.errstate(divide='ignore', invalid='ignore'):
            # Without measured velocities those between the samples.
            slopes = np.where(positive > 0.0, moves / positive, 0.0)
            if np.isnan(dq).any():
                first = slopes[:1] if len(slopes) else np.zeros((1, self.n))
                dq = np.where(np.isnan(dq), np.vstack((first, slopes)), dq)
            changes = np.where(positive > 0.0, np.diff(dq, axis=0) / positive, 0.0)
        if not self.samples:
            self.start, self.start_velocity, self.begin_time = q[0], dq[0], float(times[0])
        if self.start_acceleration is None and len(changes):
            self.start_acceleration = changes[0]
        self.path += np.abs(moves).sum(axis=0)
        self.effort += (dq[:-1] ** 2 * positive).sum(axis=0)
        self.peak_velocity = np.maximum(self.peak_velocity, np.abs(dq).max(axis=0))
        if len(changes):
            self.peak_acceleration = np.maximum(
                self.peak_acceleration, np.abs(changes).max(axis=0))
            self.end_acceleration = changes[-1]
        fresh = len(times) - (1 if self.samples else 0)
        self.samples += fresh
        self.end, self.end_velocity, self.end_time = q[-1], dq[-1], float(times[-1])
        accelerations = np.vstack((changes[:1] if len(changes) else np.zeros((1, self.n)),
                                   changes))
        return dq[-fresh:], accelerations[-fresh:]

    def measures(self) -> JointMeasures:
        still = np.zeros(self.n)
        first = still if self.start_acceleration is None else self.start_acceleration
        last = still if self.end_acceleration is None else self.end_acceleration
        return JointMeasures(
            np.abs(self.end - self.start), self.path, self.effort,
            np.abs(self.start_velocity), np.abs(self.end_velocity - self.start_velocity),
            np.abs(last - first), self.peak_velocity, self.peak_acceleration)


class _Thinned:
    """Rows of numbers, every second one dropped whenever there are too many.

    The last column is the smallest of what is dropped as well.
    """

    def __init__(self, width: int) -> None:
        self._rows = np.empty((min(2 * _SAMPLES, _NUMBERS // width), width))
        self._count, self._stride, self._skip = 0, 1, 0
        self._lowest = np.inf

    def add(self, rows: Array) -> None:
        for row in rows if self._stride > 1 else ():
            self._lowest = min(self._lowest, row[-1])
            self._skip += 1
            if self._skip >= self._stride:
                self._append(row[None])
                self._rows[self._count - 1, -1] = self._lowest
                self._skip, self._lowest = 0, np.inf
        if self._stride == 1:
            self._append(rows)

    def _append(self, rows: Array) -> None:
        while self._count + len(rows) > len(self._rows):
            kept = self._rows[:self._count]
            lowest = np.minimum(kept[:-1:2, -1], kept[1::2, -1])
            half = len(lowest)
            self._rows[:half] = kept[1::2]
            self._rows[:half, -1] = lowest
            self._count, self._stride = half, 2 * self._stride
        self._rows[self._count:self._count + len(rows)] = rows
        self._count += len(rows)

    def rows(self) -> Array:
        return self._rows[:self._count].copy()


class _Clearances:
    """The smallest clearance of every posture, and the smallest of all."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._radii = np.array([capsule.radius for capsule in robot.capsules])
        self._maps: tuple[Scene, InflatedEllipsoids] | None = None
        self.smallest: metrics.Clearance | None = None
        self.distance = np.inf

    def of(self, postures: Array, scene: Scene, first_sample: int) -> Array:
        """Return the smallest distance (k,) at postures (k, n) [m]."""
        result = np.full(len(postures), np.inf)
        if not scene.names or not len(self._radii):
            return result
        if self._maps is None or self._maps[0] is not scene:
            self._maps = scene, inflated_ellipsoids(scene, self._radii)
        maps = self._maps[1]
        step = max(_BLOCK // (len(self._radii) * len(scene.names)), 1)
        for begin in range(0, len(postures), step):
            arms = self._robot.kinematics_along(postures[begin:begin + step])
            pairs = link_clearance(maps, arms.segment_start, arms.segment_end)
            # Of an obstacle that is too far away or too large for the numbers: NaN.
            result[begin:begin + step] = np.fmin.reduce(pairs.distance, axis=(1, 2))
            clearance = np.where(
                np.isfinite(pairs.normalized_distance), pairs.normalized_distance, np.inf)
            sample, link, obstacle = np.unravel_index(
                int(clearance.argmin()), clearance.shape)
            level = float(pseudo_distance(clearance[sample, link, obstacle]))
            if np.isfinite(level) and (self.smallest is None or level < self.smallest.level):
                self.smallest = metrics.Clearance(
                    level, self._robot.capsules[int(link)].name, scene.names[int(obstacle)],
                    first_sample + begin + int(sample))
        result = np.where(np.isfinite(result), result, np.inf)
        self.distance = min(self.distance, float(result.min(initial=np.inf)))
        return result


class _Commands:
    """The twists that held, without repetitions: from when to when, and six numbers."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._rows = array.array('d')  # 8 numbers each: a long bag has millions

    def add(self, time: float, twist: Array) -> None:
        rows = self._rows
        if rows:
            rows[-7] = min(rows[-7], time)
            if rows[-7] >= time - 1e-12 and rows[-6:].tolist() == twist.tolist():
                rows[-7] = time + self._timeout
                return
        rows.extend((time, time + self._timeout, *twist.tolist()))

    def at(self, times: Array) -> Array:
        """Return the twists (k, 6) at times (k,); zero where none held."""
        if not self._rows:
            return np.zeros((len(times), 6))
        rows = np.frombuffer(self._rows).reshape(-1, 8)
        index = np.searchsorted(rows[:, 0], times, side='right') - 1
        holds = (index >= 0) & (times < rows[index, 1])
        return np.where(holds[:, None], rows[index, 2:], 0.0)


class _Scenes:
    """How the obstacles stood from when on, every second time dropped when it is too much."""

    def __init__(self, scene: Scene) -> None:
        self.kept: list[tuple[float, Scene]] = [(0.0, scene)]
        self._stride, self._seen = 1, 0

    def add(self, time: float, scene: Scene) -> None:
        if scene is self.kept[-1][1]:
            return
        self._seen += 1
        if self._seen % self._stride == 0:
            self.kept.append((time, scene))
        if (len(scene.names) + 1) * len(self.kept) > _OBSTACLES:
            self.kept[1:] = self.kept[2::2]
            self._stride *= 2


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
        robot, values = robot_of_bag(bag, params, urdf, tip, notes)
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
            return _analyse(bag, source, robot, values, begin, end, progress, notes)
        except JointsMissingError as error:
            if given:
                raise
            bag.left_out = LeftOut()
            notes.append(f'the robot of the recorded configuration is another one: {error}')
            return _analyse(bag, source, None, values, begin, end, progress, notes)


def _analyse(
    bag: Bag, source: str, robot: Robot | None, values: dict[str, Any], begin: float, end: float,
    progress: Callable[[float], None] | None, notes: list[str],
) -> Analysis:
    book = ObstacleTracker(recorded_obstacles(values, notes), (), transform=as_it_is)
    scenes = _Scenes(book.scene)
    commands = _Commands(number_of(values, 'incoming_command_timeout', COMMAND_TIMEOUT, 10.0))
    clearances = _Clearances(robot) if robot is not None else None
    joints = ChosenJoints(source, robot.joint_names if robot is not None else (), bag.left_out)
    sums, thinned = _Sums(0), _Thinned(1)
    periods: list[npt.NDArray[np.float32]] = []
    last_stamp: float | None = None
    factor: list[tuple[float, float]] = []
    for item in bag.read(('joint_states', 'joint_command', 'cmd_vel', 'obstacles', 'diagnostics'),
                         begin, end, progress, order=('obstacles',)):
        if isinstance(item, Event):
            if item.topic == 'cmd_vel':
                twist = sound_twist(item, bag.left_out)
                if twist is not None:
                    commands.add(item.arrival, twist)
            elif item.topic == 'obstacles':
                book.update(item.raw, item.arrival)
                book.expire(item.arrival)
                scenes.add(item.arrival, book.scene)
            else:
                factor += _factors(item)
            continue
        if item.topic == 'joint_command':
            stamps = item.stamps if last_stamp is None else np.append(last_stamp, item.stamps)
            periods.append(np.diff(stamps).astype(np.float32))
            last_stamp = float(item.stamps[-1])
        if item.topic != source:
            continue
        book.expire(float(item.arrivals[0]))
        chosen = joints.of(item)
        if chosen is None:
            continue
        if not sums.samples:
            sums, thinned = _Sums(len(joints.names)), _Thinned(3 * len(joints.names) + 2)
        q = chosen.positions
        distance = (clearances.of(q, book.scene, sums.samples) if clearances is not None
                    else np.full(len(q), np.inf))
        dq, ddq = sums.add(chosen.stamps, q, chosen.velocities)
        thinned.add(np.column_stack((chosen.stamps, q, dq, ddq, distance)))
    if not sums.samples:
        joints.check_found()
        raise RecordingError('; '.join((
            f"'{bag.path}' has no {source} between {begin:g} and {end:g} s", *bag.problems)))
    if sums.backwards:
        notes.append(f'time goes backwards {sums.backwards} times; those steps count for nothing')
    if sums.gaps:
        notes.append(f'{source} pauses {sums.gaps} times for more than {GAP:g} s, at most '
                     f'{sums.longest_gap:.6g} s; how fast the arm was meanwhile is not known')
    notes += bag.problems
    intervals = np.concatenate(periods) if periods else np.empty(0, np.float32)
    return Analysis(
        printable(bag.path.absolute().name), robot, joints.names, sums.samples,
        sums.begin_time, sums.end_time,
        sums.measures(), _curves(robot, thinned.rows(), commands, scenes.kept),
        clearances.smallest if clearances is not None else None,
        clearances.distance if clearances is not None else np.inf,
        _periods(intervals), np.array(factor).reshape(-1, 2),
        tuple(dict.fromkeys(printable(note) for note in notes)))


def _periods(intervals: npt.NDArray[np.float32]) -> metrics.Periods | None:
    if not len(intervals):
        return None
    return metrics.Periods(float(np.median(intervals)), float(np.percentile(intervals, 99)),
                           float(intervals.max()))


def _factors(item: Event) -> list[tuple[float, float]]:
    """Return the time and k of every planner's status in a DiagnosticArray."""
    found = []
    for status in item.message.status:
        for entry in status.values:
            if entry.key == 'factor k':
                try:
                    factor = float(entry.value)
                except ValueError:
                    continue
                if np.isfinite(factor):
                    found.append((item.arrival, factor))
    return found


def _curves(
    robot: Robot | None, rows: Array, commands: _Commands, scenes: list[tuple[float, Scene]],
) -> Curves:
    n = (rows.shape[1] - 2) // 3
    times, q, dq, ddq = rows[:, 0], rows[:, 1:1 + n], rows[:, 1 + n:1 + 2 * n], rows[:, -1 - n:-1]
    scale: Array = np.full(len(rows), np.nan)
    error: Array = scale
    tips: Array = np.full((len(rows), 3), np.nan)
    if robot is not None:
        twists = commands.at(times)
        arms = robot.kinematics_along(q)
        tips = arms.tip_position
        task = np.array([robot.task_rows(twist) for twist in twists])
        size = (task * task).sum(axis=1)
        followed = ((arms.jacobian @ dq[:, :, None])[:, :, 0] * task).sum(axis=1)
        with np.errstate(divide='ignore', invalid='ignore'):
            scale = np.where(size > 0.0, followed / size, np.nan)
        error = path_errors(robot, times, twists, tips, arms.tip_rotation)
    return Curves(times, q, dq, ddq, rows[:, -1], scale, tips, error, tuple(scenes))


def path_errors(
    robot: Robot, times: Array, twists: Array, tips: Array, rotations: Array,
) -> Array:
    """Return the distance (k,) of the tip from the path it was commanded along [m].

    A path begins where the tip is when a command begins, and leads where the twists do, each
    held until the next sample. How fast the tip goes along it does not count. NaN before
    the first command.

    Args:
        robot: the arm.
        times: (k,) [s].
        twists: (k, 6) in the command frame.
        tips, rotations: (k, 3) and (k, 3, 3) of the tip.
    """
    moving = np.asarray(twists.any(axis=1))
    errors = np.full(len(times), np.nan)
    begins = np.flatnonzero(moving & ~np.concatenate(((False,), moving[:-1])))
    for begin, after in zip(begins, (*begins[1:], len(times))):
        pose = Pose(tips[begin], rotations[begin])
        points = [pose.position]
        for i in range(begin, after - 1):
            if not moving[i]:
                break
            step = float(times[i + 1] - times[i])
            pose = se3.integrate(
                pose, twists[i], step if 0.0 < step <= GAP else 0.0, robot.in_tool)
            points.append(pose.position)
        path: Array = np.array(points)
        at = 0
        for i in range(begin, after):
            low, high = max(at - _BEHIND, 0), min(at + _AHEAD, len(path))
            window = path[low:high]
            apart = ((window - tips[i]) ** 2).sum(axis=1)
            nearest = int(apart.argmin())
            at = low + nearest
            around = window[max(nearest - 1, 0):nearest + 2]
            errors[i] = metrics.distance_to_path(tips[i:i + 1], around)[0]
    return errors


def robot_of_bag(
    bag: Bag, params: Path | None, urdf: str, tip: str, notes: list[str],
) -> tuple[Robot | None, dict[str, Any]]:
    """Return the robot of a bag and all parameter values that are known of its planner.

    Args:
        bag: open for reading.
        params, urdf, tip: as for `analyse`.
        notes: takes a sentence where something had to be guessed.

    Raises:
        PlannerError: what was given cannot be used.
    """
    configuration = description = ''
    for item in bag.read(('configuration', 'robot_description')):
        if isinstance(item, Event):
            if item.topic == 'configuration':
                configuration = item.message.data
            else:
                description = item.message.data
    values = configuration_of(configuration, notes) if configuration else {}
    if params is not None:
        return load_robot(params, **({'urdf': urdf} if urdf else {})), values
    if urdf:
        file = resolve(urdf)
        return _robot_of_urdf(file.read_text(), tip, file, notes), values
    try:
        if values:
            return robot_of_values(values), values
        if description:
            return _robot_of_urdf(description, tip, None, notes), values
    except Exception as error:  # a bag may hold anything, and is analysed all the same
        if tip and isinstance(error, PlannerError):
            raise
        notes.append(f'no robot: the recorded one is unusable ({error}); give --urdf or --params '
                     'for the tool and the clearance')
        return None, values
    notes.append('no robot: neither configuration nor robot_description was recorded; give --urdf '
                 'or --params for the tool and the clearance')
    return None, values


def _robot_of_urdf(text: str, tip: str, file: Path | None, notes: list[str]) -> Robot:
    parameters = RobotParameters(
        urdf=str(file) if file is not None else '', robot_description=text,
        tip_frame=tip or likely_tip(text))
    if not tip:
        notes.append(f"tip_frame '{parameters.tip_frame}' is a guess; --tip names another")
    try:
        return build_robot(parameters, text, {})
    except PlannerError as error:
        notes.append(f'link shapes are straight and {_UNKNOWN_RADIUS} m thick: {error}')
        return build_robot(replace(parameters, link_shapes='straight', velocity_max=(
            1.0,) if 'velocity_max' in str(error) else (), link_radius=_UNKNOWN_RADIUS), text, {})


def reduction(base: Array, improved: Array) -> Array:
    """Return by how much a measure became smaller [%], NaN where there was nothing."""
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.where(base > _NOTHING, 100.0 * (base - improved) / base, np.nan)


def obstacles_at(curves: Curves, time: float) -> tuple[Obstacle, ...]:
    """Return the obstacles as they stood at a time [s]."""
    return scene_at(curves, time).obstacles()


def scene_at(curves: Curves, time: float) -> Scene:
    """Return the obstacles as they stood at a time [s], as a scene."""
    scene = curves.scenes[0][1]
    for begin, candidate in curves.scenes:
        if begin > time:
            break
        scene = candidate
    return scene
