"""The operator's command: the latest twist or target, its age, and the preview of later twists."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, ObstacleError, StateError
from redundant_planner.core.horizon.preview import Preview, TwistAhead
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, Poses
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import checked_target, Target
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.io.chunk_reader import read_path, read_trajectory, ReadChunk
from redundant_planner.io.obstacle_tracker import Transform
from redundant_planner.io.preview_reader import read_preview
from redundant_planner.io.target_reader import read_joint_target, read_target
from redundant_planner.nodes import messages

Array = npt.NDArray[np.float64]

# How far in the future a stamp may lie before it must come from another clock [s].
_FUTURE = 0.1
# Joints that a stream does not name stay where it has them, not where they are measured, while its
# messages are no further apart [s].
_STREAM = 0.5
# How long before its beginning a preview may come, and a chunk [s].
_ANNOUNCED, _CHUNK_ANNOUNCED = 3600.0, 60.0


class CommandInput:
    """The twist or target in force, whichever came last. A twist ages from the moment it came.

    Attributes:
        frame: 'base' or 'tool', the axes of the latest twist.
        timeout: how old the stamp of a message may be when it arrives [s].
        previews: how many previews were taken so far.
    """

    def __init__(
        self, frames: dict[str, str], command_frame: str, clock: Callable[[], float],
        ros_time: Callable[[], float], warn: Callable[[str], None],
        transform: Callable[..., Transform] | None = None,
    ) -> None:
        """Begin without a command.

        Args:
            frames: names of the base's and the tip's frames → 'base' or 'tool'.
            command_frame: of messages that name no frame.
            clock: of the loop, by which commands age [s].
            ros_time: that message stamps are compared with [s].
            warn: takes a sentence about a message that was refused.
            transform: see `transform_lookup`.
        """
        self._transform = transform
        self._frames, self._command_frame = frames, command_frame
        self._clock, self._ros_time, self._warn = clock, ros_time, warn
        self._unstamped = False
        self.timeout = 0.1
        self.previews = 0
        self._preview_start = 0.0
        self._ahead_at = 0.0
        self.forget()
        self.forget_preview()

    def forget(self) -> None:
        """Drop the command: motion begins with a new one.

        A preview stays: it moves nothing by itself, and the motion it announced is still to come.
        """
        self._twist: Array = np.zeros(6)
        self._time = -np.inf
        self.frame = self._command_frame
        self.forget_target()

    def forget_target(self) -> None:
        """Let go of the target."""
        self._target: Target | None = None
        self._from_tip = False
        self._target_came = -np.inf
        self._news: list[Sighting] = []

    @property
    def has_target(self) -> bool:
        """Whether a target commands the arm."""
        return self._target is not None

    @property
    def known_target(self) -> Target | None:
        """The target; None without one, or before its first tick."""
        return None if self._from_tip else self._target

    def target(self, places: Poses) -> Target | None:
        """Return where the arm shall go; None if a twist commands.

        Args:
            places: where the tip should be now; a pose in the tip's frame is meant from there.
        """
        if self._from_tip and isinstance(self._target, Pose):
            self._target = se3.composed(places.first, self._target)
        elif self._from_tip and isinstance(self._target, Chunk):
            self._target = _placed(places.first, self._target)
        self._from_tip = False
        return self._target

    def take_news(self) -> tuple[Sighting, ...]:
        """Return the targets that came since the last call."""
        news, self._news = tuple(self._news), []
        return news

    def forget_preview(self) -> None:
        """Drop the preview: its time means nothing any more."""
        self._preview: Preview | None = None

    def age(self) -> float:
        """Return how long ago the command came [s], infinite without one."""
        return self._clock() - self._time

    def moves(self, timeout: float) -> bool:
        """Return whether a twist that is not older than `timeout` moves the tip."""
        return self._is_fresh(timeout) and bool(self._twist.any())

    def twist(self, timeout: float, places: Callable[[], Poses]) -> Array:
        """Return the twist (6,) in command axes.

        Args:
            timeout: one that is older counts as zero [s].
            places: returns where the tip is.
        """
        if not self._is_fresh(timeout):
            return np.zeros(6)
        if self.frame == self._command_frame or not self._twist.any():
            return self._twist
        rotation = places().rotation[0]
        return se3.turned(self._twist, rotation if self.frame == 'tool' else rotation.T)

    def ahead(self, timeout: float) -> TwistAhead | None:
        """Return the twists that will be commanded from now on.

        None without a preview that still holds, or with a command older than `timeout`.
        """
        preview, elapsed = self._preview, self._clock() - self._preview_start
        if preview is None or elapsed > preview.times[-1] or not self._is_fresh(timeout):
            return None
        self._ahead_at = elapsed
        return preview.ahead(elapsed)

    def _is_fresh(self, timeout: float) -> bool:
        """Return whether the command counts; one in the future is of a clock that was set back."""
        return 0.0 <= self.age() <= timeout

    def preview_elapsed(self) -> float:
        """Return where in the preview `ahead` last began [s]."""
        return self._ahead_at

    def on_twist(self, raw: bytes) -> None:
        """Take a serialised Twist, in command axes."""
        try:
            self._take(messages.twist_from_bytes(raw), self._command_frame)
        except StateError as error:
            self._warn(f'cmd_vel ignored: {error}')

    def on_twist_stamped(self, raw: bytes) -> None:
        """Take a serialised TwistStamped, which gives its frame and its time.

        No stamp counts as now. A stamp older than `timeout`, or one from a clock that runs ahead,
        is refused: two clocks that differ must not move the arm.
        """
        try:
            stamp, name, twist = messages.stamped_twist_from_bytes(raw)
        except StateError as error:
            self._warn(f'cmd_vel ignored: {error}')
            return
        if stamp == 0.0 and not self._unstamped:
            self._unstamped = True
            self._warn('cmd_vel has no stamp: it counts as now (said once)')
        late = self._ros_time() - stamp if stamp else 0.0
        if not -_FUTURE <= late <= self.timeout:
            self._warn(f'cmd_vel ignored: its stamp is {late:.3f} s old; it may be '
                       f'{self.timeout:g} s' if late > 0.0 else
                       f'cmd_vel ignored: its stamp lies {-late:.3f} s in the future; do sender '
                       'and planner use the same clock (use_sim_time)?')
            return
        if name and name not in self._frames:
            self._warn(f'cmd_vel ignored: it is given in frame {name!r}; it must be in '
                       f'{known(self._frames)}')
            return
        self._take(twist, self._frames.get(name, self._command_frame), late)

    def _take(self, twist: Array, frame: str, late: float = 0.0) -> None:
        self._twist = twist
        self._time = self._clock() - max(late, 0.0)
        self.frame = frame
        self.forget_target()

    def on_target(self, raw: bytes) -> None:
        """Take a serialised target; it holds until something else is commanded."""
        try:
            stamp, name, pose = read_target(raw)
            kind = self._frames.get(name) if name else 'base'
            if kind is None:
                pose = self._from_elsewhere(name, pose)
        except StateError as error:
            self._warn(f'target_pose ignored: {error}')
            return
        ahead = stamp - self._ros_time() if stamp else 0.0
        if ahead > _FUTURE:
            self._warn(f'target_pose ignored: its stamp lies {ahead:.3f} s in the future; do '
                       'sender and planner use the same clock (use_sim_time)?')
            return
        self._take_target(pose, stamp, from_tip=kind == 'tool')

    def on_joint_target(self, raw: bytes, robot: Robot, posture: Array | None) -> None:
        """Take a serialised target of the joints; it holds until something else is commanded.

        Args:
            raw: the message.
            robot: the arm.
            posture: (n,) measured, where joints stay that are not named; None if unknown.
        """
        try:
            if posture is None:
                raise StateError('nothing was heard on joint_states yet')
            before = self._target
            goes_on = self._clock() - self._target_came < _STREAM
            rest = before if isinstance(before, np.ndarray) and goes_on else posture
            stamp, q = read_joint_target(raw, robot, rest)
        except StateError as error:
            self._warn(f'target_joints ignored: {error}')
            return
        self._take_target(q, stamp)

    def _take_target(self, target: Pose | Array, stamp: float, *, from_tip: bool = False) -> None:
        """Take a target, and its stamp, 0 for none [s]."""
        if isinstance(target, Pose) != isinstance(self._target, Pose) or from_tip:
            self._news = []
        self._target, self._from_tip, self._target_came = target, from_tip, self._clock()
        if not from_tip:  # a displacement is no place that one could follow
            self._news.append(Sighting(target, self._ros_time() - stamp if stamp else None))

    def on_path(self, raw: bytes) -> None:
        """Take a serialised chunk of poses; it holds until something else is commanded."""
        try:
            read = read_path(raw)
            kind = self._frames.get(read.frame) if read.frame else 'base'
            chunk = self._chunk(read)
            if kind is None:
                chunk = _placed(self._from_elsewhere(
                    read.frame, Pose(np.zeros(3), np.eye(3))), chunk)
        except StateError as error:
            self._warn(f'target_path ignored: {error}')
            return
        self._take_chunk(chunk, from_tip=kind == 'tool')

    def on_trajectory(self, raw: bytes, robot: Robot, posture: Array | None) -> None:
        """Take a serialised chunk of joint positions, see `on_joint_target`."""
        try:
            if posture is None:
                raise StateError('nothing was heard on joint_states yet')
            chunk = self._chunk(read_trajectory(raw, robot, posture))
            checked_target(chunk, robot)
        except StateError as error:
            self._warn(f'target_trajectory ignored: {error}')
            return
        self._take_chunk(chunk)

    def _take_chunk(self, chunk: Chunk, *, from_tip: bool = False) -> None:
        """Take a chunk; targets that came before it in the same tick do not count."""
        self._target, self._from_tip, self._target_came = chunk, from_tip, -np.inf
        self._news = []

    def _chunk(self, read: ReadChunk) -> Chunk:
        """Return a chunk that has been read.

        Raises:
            StateError: it is none, is over, or begins too late.
        """
        late = self._ros_time() - read.stamp if read.stamp else 0.0
        ago = late - float(read.times[-1])
        if read.stamp and not (ago <= 0.0 and -late <= _CHUNK_ANNOUNCED):
            when = (f'its last point was due {ago:.3f} s ago' if ago > 0.0 else
                    f'it begins {-late:.3f} s from now, up to {_CHUNK_ANNOUNCED:g} s are allowed')
            raise StateError(f'by its stamps {when}; do sender and planner use the same clock '
                             '(use_sim_time)?')
        return Chunk(read.times, read.points, read.velocities, late)

    def _from_elsewhere(self, name: str, pose: Pose) -> Pose:
        """Return a pose given in another frame in the base's.

        Raises:
            StateError: there is no tf2 to ask, or it does not know the frame.
        """
        if self._transform is None:
            raise StateError(f'it is given in frame {name!r}; without tf2_ros it must be in '
                             f'{known(self._frames)}')
        try:
            return se3.composed(Pose(*self._transform(name)), pose)
        except ObstacleError as error:
            raise StateError(f'it is given in frame {name!r}: {error}') from None

    def on_preview(self, raw: bytes) -> None:
        """Take a serialised preview: the commands from the message's stamp on.

        A preview that begins too late or is over counts in `previews`, but is not used.
        """
        try:
            stamp, preview = read_preview(raw)
        except StateError as error:
            self._warn(f'cmd_vel_preview ignored: {error}')
            return
        late = self._ros_time() - stamp if stamp else 0.0
        self.previews += 1
        self._preview, self._preview_start = preview, self._clock() - late
        if not -_ANNOUNCED <= late <= preview.times[-1]:
            self._preview = None
            self._warn(f'cmd_vel_preview ignored: by its stamp it begins {-late:.3f} s from now '
                       f'and ends {preview.times[-1] - late:.3f} s from now; do sender and '
                       'planner use the same clock (use_sim_time)?')


def _placed(frame: Pose, chunk: Chunk) -> Chunk:
    """Return poses that are given relative to another one, in the frame of that one."""
    assert isinstance(chunk.points, tuple), 'joint positions are relative to nothing'
    return Chunk(chunk.times, tuple(se3.composed(frame, pose) for pose in chunk.points),
                 late=chunk.late)
