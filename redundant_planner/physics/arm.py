"""An arm with mass, drives and obstacles around it, that obeys commands as far as it can.

Each drive holds a reference. A velocity command moves it on (`servo: velocity`), a position
command sets it (`servo: position`). The torque of a joint is

    τ = stiffness · (reference − q) + damping · (its velocity − q̇) + what gravity and motion take,

within the effort limit. The last part comes from the nominal model, the URDF's, so an arm of
another mass sags a little, as real ones do.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.simulated_arm import JointRanges, SimulatedArm
from redundant_planner.io.physics_parameters import NO_SERVO, PhysicsParameters, POSITION_SERVO
from redundant_planner.physics.contacts import ContactLog
from redundant_planner.physics.model import arm_model
from redundant_planner.physics.obstacle_places import ObstaclePlaces

Array = npt.NDArray[np.float64]

# A step that is due this soon is taken, as times are sums of rounded periods [s].
_ROUND_OFF = 1e-9


class _Command(NamedTuple):
    """What the joints shall do from a moment on."""

    time: float
    velocities: Array
    positions: Array | None


class PhysicsArm:
    """An arm as MuJoCo simulates it; time comes in with every call, as for `SimulatedArm`.

    Attributes:
        name: of the robot.
        ranges: of the n joints.
        contacts: of links with obstacles and with each other.
        largest_demand: (n,) the most that each joint was asked for, as a share of its effort
            limit. What is beyond 1 its drive did not have.
        remarks: sentences about what was assumed of the URDF.
        step: of the physics [s].
        steps: taken so far.
    """

    def __init__(
        self, robot: Robot, parameters: PhysicsParameters, start: Mapping[str, float],
    ) -> None:
        """Stand still at the start posture; joints not named in it stand at 0 or at a limit.

        Args:
            robot: the arm's URDF, and its links' capsules.
            parameters: of the physics.
            start: joint name → position [rad, m].

        Raises:
            RobotError: the URDF cannot be simulated, or a joint is unknown or starts outside its
                limits.
            PhysicsError: MuJoCo refuses the model.
        """
        self._arm = arm_model(robot, parameters)
        self.name = robot.name
        self.ranges: JointRanges = self._arm.ranges
        self.remarks = self._arm.remarks
        # The ideal arm checks the start posture, and knows where the other joints stand.
        self._reference = SimulatedArm(
            self.ranges, dict(start), command_timeout=parameters.command_timeout).q
        self._parameters = parameters
        self._data = mujoco.MjData(self._arm.model)
        self._believed = mujoco.MjData(self._arm.nominal)
        self._needed = np.zeros(self._arm.model.nv)
        self._data.qpos[self._arm.positions] = self._reference
        for place, leader, multiplier, offset in self._arm.followers:
            self._data.qpos[place] = multiplier * self._data.qpos[leader] + offset
        mujoco.mj_forward(self._arm.model, self._data)
        self._places = ObstaclePlaces(self._arm)
        self.contacts = ContactLog()
        self.largest_demand = np.zeros(len(self._reference))
        self.step, self.steps = 1.0 / parameters.physics_rate, 0
        # The reference may lead by as much as takes all of the effort.
        with np.errstate(divide='ignore', invalid='ignore'):
            self._lead = np.where(self._arm.stiffness > 0.0,
                                  self._arm.effort_max / self._arm.stiffness, np.inf)
        self._waiting: deque[_Command] = deque()
        self._velocity = np.zeros_like(self._reference)
        self._now, self._expires = -np.inf, -np.inf

    @property
    def q(self) -> Array:
        """Positions at the last advance (n,) [rad, m]."""
        return np.array(self._data.qpos[self._arm.positions])

    @property
    def dq(self) -> Array:
        """Velocities at the last advance (n,) [rad/s, m/s]."""
        return np.array(self._data.qvel[self._arm.velocities])

    @property
    def torques(self) -> Array:
        """What the drives exert (n,) [Nm, N]."""
        return np.array(self._data.actuator_force)

    @property
    def effort_max(self) -> Array:
        """Effort limits (n,) [Nm, N], infinite where the URDF has none."""
        return self._arm.effort_max.copy()

    @property
    def stiffness(self) -> Array:
        """Of the servo (n,) [Nm/rad, N/m]."""
        return self._arm.stiffness.copy()

    @property
    def model(self) -> mujoco.MjModel:
        """The model, for those who look at it."""
        return self._arm.model

    @property
    def data(self) -> mujoco.MjData:
        """The model's state, for those who look at it."""
        return self._data

    @property
    def obstacles(self) -> int:
        """How many obstacles are bodies now."""
        return len(self._places.names)

    def command(self, now: float, velocities: Array, positions: Array | None = None) -> None:
        """Move at `velocities` (n,) from `now` and the dead time on, or hold `positions` (n,).

        Args:
            now: [s].
            velocities: [rad/s, m/s].
            positions: [rad, m]; None, or NaN for a joint, leaves a position servo's reference to
                the velocities.
        """
        limit = self.ranges.velocity_max
        self._waiting.append(_Command(
            now + self._parameters.lag, np.clip(velocities, -limit, limit), positions))

    def surround(self, scene: Scene) -> None:
        """Make the obstacles of a scene bodies that the arm can run into."""
        self._places.show(scene, self._data)

    def advance(self, now: float) -> None:
        """Simulate up to `now` [s]; a clock that goes backwards moves nothing."""
        if not np.isfinite(self._now):
            self._now = now
        while self._now + self.step <= now + _ROUND_OFF:
            self._step()
            self._now += self.step

    def skip_to(self, now: float) -> None:
        """Go on from `now` without simulating what lies between [s]."""
        self._now = max(self._now, now)

    def _step(self) -> None:
        arm, data = self._arm, self._data
        velocity = self._moved_reference()
        if self._parameters.servo != NO_SERVO:
            data.ctrl[:] = (arm.stiffness * self._reference + arm.damping * velocity
                            + self._believed_need())
            asked = (data.ctrl - arm.stiffness * data.qpos[arm.positions]
                     - arm.damping * data.qvel[arm.velocities])
            self.largest_demand = np.maximum(
                self.largest_demand, np.abs(asked) / arm.effort_max)
        mujoco.mj_step(arm.model, data)
        self.steps += 1
        if data.ncon or any(contact.touching for contact in self.contacts.contacts):
            self.contacts.note(self._touches(), float(data.time))

    def _moved_reference(self) -> Array:
        """Move the reference on by a step; return its velocity (n,)."""
        while self._waiting and self._waiting[0].time <= self._now + _ROUND_OFF:
            command = self._waiting.popleft()
            self._velocity = command.velocities
            self._expires = command.time + self._parameters.command_timeout
            if self._parameters.servo == POSITION_SERVO and command.positions is not None:
                # This step moves the reference on by the velocity, which is the next command's.
                given = command.positions - self.step * self._velocity
                self._reference = np.where(np.isnan(given), self._reference, given)
        if self._now >= self._expires - _ROUND_OFF:
            self._velocity = np.zeros_like(self._velocity)
        q = self._data.qpos[self._arm.positions]
        wanted = self._reference + self.step * self._velocity
        allowed = np.clip(wanted, self.ranges.position_min, self.ranges.position_max)
        self._reference = np.clip(allowed, q - self._lead, q + self._lead)
        return np.where(allowed == wanted, self._velocity, 0.0)

    def _believed_need(self) -> Array:
        """Return what gravity and motion take of each joint (n,), by the nominal model."""
        arm, believed = self._arm, self._believed
        believed.qpos[:], believed.qvel[:] = self._data.qpos, self._data.qvel
        mujoco.mj_kinematics(arm.nominal, believed)
        mujoco.mj_comPos(arm.nominal, believed)
        mujoco.mj_comVel(arm.nominal, believed)
        mujoco.mj_rne(arm.nominal, believed, 0, self._needed)
        return self._needed[arm.velocities]

    def _touches(self) -> Iterator[tuple[str, str, float]]:
        """Yield who touches whom in this step, and how deep [m]."""
        shapes, names = self._arm.shapes, self._places.names
        first = int(self._arm.places[0])
        contact = self._data.contact
        for (one, other), distance in zip(contact.geom.tolist(), contact.dist.tolist()):
            if one not in shapes:
                one, other = other, one
            yield (shapes[one], shapes[other] if other in shapes else names[other - first],
                   -distance)
