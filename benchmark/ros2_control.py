"""ros2_control, simulated: a manager, its broadcaster, one controller and the hardware behind.

ros2_control is not on PyPI. `Manager` follows the rules of controller_manager 4.46 and of the
controllers 4.42 as they were measured. It knows no ROS and no clock, so that it runs cycle by
cycle, as fast as one likes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

VELOCITY, POSITION, TRAJECTORY = 'velocity', 'position', 'trajectory'
# The planner's output for each controller, and the topic that the controller listens to.
OUTPUTS = {VELOCITY: 'velocity_commands', POSITION: 'position_commands',
           TRAJECTORY: 'joint_trajectory'}
CONTROLLERS = {VELOCITY: '/forward_velocity_controller/commands',
               POSITION: '/forward_position_controller/commands',
               TRAJECTORY: '/joint_trajectory_controller/joint_trajectory'}
# joint_trajectory_controller takes a velocity up to this for zero [rad/s, m/s].
_ZERO = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class Settings:
    """What a test may change while the arm moves; joints by name, all others as they should be.

    Attributes:
        active: whether the controller is.
        allow_nonzero_velocity_at_trajectory_end: of joint_trajectory_controller.
        frozen: the hardware stands and says so, as a simulator that does not go on.
        dead: the readings stay what they were, whatever the arm does; stamps are fresh.
        stuck: joints that do not move.
        gain: joint → how far it moves for each unit that it is told to.
        moved: joint → how fast another controller moves it meanwhile [rad/s, m/s].
        pushed: joint → how fast somebody pushes it; a position drive brings it back [rad/s, m/s].
        lag: of the drives, of first order [s].
        dead_time: from the manager's write to the drives' reaction [s].
        backlash: between drive and link [rad, m].
        noise: standard deviation of the measured positions [rad, m].
        states_rate: of joint_states [Hz]; 0 for each cycle.
        states_delay: how late joint_states come, their stamps being true [s].
    """

    active: bool = True
    allow_nonzero_velocity_at_trajectory_end: bool = False
    frozen: bool = False
    dead: bool = False
    stuck: Sequence[str] = ()
    gain: Mapping[str, float] = field(default_factory=dict)
    moved: Mapping[str, float] = field(default_factory=dict)
    pushed: Mapping[str, float] = field(default_factory=dict)
    lag: float = 0.0
    dead_time: float = 0.0
    backlash: float = 0.0
    noise: float = 0.0
    states_rate: float = 0.0
    states_delay: float = 0.0


class Point(NamedTuple):
    """A point of a trajectory: [s], and for the joints that it names [rad, m; per s]."""

    time: float
    positions: Sequence[float] | Array
    velocities: Sequence[float] | Array = ()


class Manager:
    """One cycle after the other: read the hardware, update the controller, write.

    Attributes:
        names: joints of the hardware, in the order of its URDF.
        settings: assign new ones at any time.
        q, dq: (n,) where the links are and how fast they moved in the last cycle [rad, m; per s].
        measured, measured_velocities: (n,) what the broadcaster says of them.
        written: (n,) the command interface, positions or velocities.
        refused: messages that the controller did not take, and `error` why not the last one.
    """

    def __init__(
        self, names: Sequence[str], start: Sequence[float], controller: str,
        joints: Sequence[str], period: float, settings: Settings,
    ) -> None:
        """Stand still.

        Args:
            names: of the hardware's n joints.
            start: n positions [rad, m].
            controller: VELOCITY or POSITION (forward_command_controller) or TRAJECTORY.
            joints: the controller's parameter; the others stay where they are.
            period: of the manager [s].
            settings: at the start.
        """
        self.names, self.period = tuple(names), period
        self.controller, self._joints = controller, list(joints)
        self._index = [self.names.index(name) for name in joints]
        self.settings = settings
        self.q = np.array(start, dtype=float)
        self.dq = np.zeros_like(self.q)
        self.measured, self.measured_velocities = self.q.copy(), self.dq.copy()
        self.written = self.dq.copy() if controller == VELOCITY else self.q.copy()
        self.refused, self.error = 0, ''
        self._motor = self.q.copy()  # on the drive's side of the backlash
        self._motor_velocity = self.dq.copy()
        self._aimed = self.q.copy()  # where a position drive pulls to
        self._obeyed = self.written.copy()
        self._on_the_way: deque[tuple[int, Array]] = deque()
        self._cycles = 0
        self._random = np.random.default_rng(0)
        self._was_active = settings.active
        self._message: Array | None = None  # of a forward_command_controller
        self._points: list[Point] = []
        self._from: Point | None = None  # where the trajectory began, None before it was sampled
        self._begun = 0

    def forward(self, values: Sequence[float]) -> None:
        """Take a message of a forward_command_controller."""
        if len(values) != len(self._index):
            self._refuse(f'command size ({len(values)}) does not match number of interfaces '
                         f'({len(self._index)})')
        elif self.settings.active:
            self._message = np.array(values)

    def trajectory(self, joints: Sequence[str], points: Sequence[Point]) -> None:
        """Take a trajectory that starts now, if the controller would."""
        if not self.settings.active:
            return
        if set(joints) != set(self._joints) or len(joints) != len(self._joints):
            self._refuse("joints on incoming trajectory don't match the controller's joints")
        elif not points or any(
                later.time <= point.time for point, later in pairwise(points)):
            self._refuse('time between points is not strictly increasing')
        elif any(len(point.positions) != len(joints)
                 or len(point.velocities) not in (0, len(joints)) for point in points):
            self._refuse('mismatch between joint_names and positions or velocities')
        elif (not self.settings.allow_nonzero_velocity_at_trajectory_end
              and np.any(np.abs(points[-1].velocities) > _ZERO)):
            self._refuse('velocity of last trajectory point is not zero')
        else:
            order = [list(joints).index(name) for name in self._joints]
            self._points = [Point(point.time, np.array(point.positions)[order],
                                  np.array(point.velocities)[order] if len(point.velocities)
                                  else ()) for point in points]
            self._from = None

    def cycle(self) -> None:
        """Read, update, write."""
        self._cycles += 1
        self._read()
        if self.settings.active and not self._was_active:
            # forward_command_controller waits for the next message; the other one holds.
            self._message = None
            self._points = [Point(0.0, self.measured[self._index])]
            self._from = None
        self._was_active = self.settings.active
        if self.settings.active:
            if self.controller != TRAJECTORY:
                if self._message is not None:
                    self.written[self._index] = self._message
            else:
                self.written[self._index] = self._sampled()
        delay = round(self.settings.dead_time / self.period)
        self._on_the_way.append((self._cycles + 1 + delay, self.written.copy()))

    def go_on_alone(self, cycles: int) -> None:
        """Have the hardware go on for so many cycles while this process was stopped."""
        for _ in range(cycles):
            self._cycles += 1
            self._read()

    def _refuse(self, why: str) -> None:
        self.refused, self.error = self.refused + 1, why

    def _sampled(self) -> Array:
        """Return where the trajectory is one period from now, as the controller's command."""
        if self._from is None:
            self._begun = self._cycles
            self._from = Point(0.0, self.measured[self._index],
                               self.measured_velocities[self._index])
        now = (self._cycles - self._begun + 1) * self.period
        points = [self._from, *self._points]
        for before, after in pairwise(points):
            if now < after.time:
                return _between(before, after, now)
        return np.asarray(points[-1].positions)

    def _read(self) -> None:
        """Have a period pass for the hardware, and measure it."""
        settings, period = self.settings, self.period
        told_before = self._obeyed
        while self._on_the_way and self._on_the_way[0][0] <= self._cycles:
            self._obeyed = self._on_the_way.popleft()[1]
        gain, moved, pushed = self._each(settings.gain, 1.0), self._each(settings.moved), \
            self._each(settings.pushed)
        share = 1.0 - np.exp(-period / settings.lag) if settings.lag > 0.0 else 1.0
        if self.controller == VELOCITY:
            self._motor_velocity += (gain * self._obeyed - self._motor_velocity) * share
            motor = self._motor + (self._motor_velocity + moved) * period
        else:
            self._aimed += gain * (self._obeyed - told_before) + moved * period
            motor = self._motor + (self._aimed - self._motor) * share
        motor = motor + pushed * period
        still = np.array([settings.frozen or name in settings.stuck for name in self.names])
        self._motor = np.where(still, self._motor, motor)
        if self.controller != VELOCITY:
            # Whoever else moves the arm writes the same interface.
            self.written += moved * period
            self._obeyed = self._obeyed + moved * period
        half = 0.5 * settings.backlash
        q = np.clip(self.q, self._motor - half, self._motor + half)
        self.q, self.dq = q, (q - self.q) / period
        if not settings.dead:
            noise = (self._random.normal(0.0, settings.noise, len(q)) if settings.noise > 0.0
                     else 0.0)
            self.measured, self.measured_velocities = q + noise, self.dq.copy()

    def _each(self, values: Mapping[str, float], otherwise: float = 0.0) -> Array:
        return np.array([values.get(name, otherwise) for name in self.names])


def _between(before: Point, after: Point, now: float) -> Array:
    """Interpolate as joint_trajectory_controller does: cubic if both points have velocities."""
    whole, since = after.time - before.time, now - before.time
    p, q = np.asarray(before.positions), np.asarray(after.positions)
    if not len(before.velocities) or not len(after.velocities):
        return p + (q - p) * (since / whole)
    v, w = np.asarray(before.velocities) * whole, np.asarray(after.velocities) * whole
    s = since / whole
    return p + s * (v + s * (3.0 * (q - p) - 2.0 * v - w + s * (2.0 * (p - q) + v + w)))


class Broadcaster:
    """joint_state_broadcaster: what was measured, at its rate and as late as `Settings` has it."""

    def __init__(self, manager: Manager) -> None:
        """Begin with nothing said."""
        self._manager = manager
        self._due = 0.0
        self._late: deque[tuple[float, float, Array, Array]] = deque()

    def cycle(self, now: float) -> list[tuple[float, Array, Array]]:
        """Return what comes out after a cycle: stamps [s], positions and velocities (n,).

        Args:
            now: [s].
        """
        manager, settings = self._manager, self._manager.settings
        if settings.states_rate <= 0.0 or now >= self._due:
            if settings.states_rate > 0.0:
                self._due = max(self._due + 1.0 / settings.states_rate, now)
            self._late.append((now + settings.states_delay, now, manager.measured,
                               manager.measured_velocities))
        out = []
        while self._late and self._late[0][0] <= now:
            out.append(self._late.popleft()[1:])
        return out
