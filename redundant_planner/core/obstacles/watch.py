"""Which obstacles a tick looks at: the memory around `nearby.surroundings`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.contacts import AllowedContacts
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.nearby import (
    everything,
    FEW,
    Kept,
    MOST_NEAR,
    Surroundings,
    surroundings,
)
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.limits import barrier_rate, Limits, stopping_time
from redundant_planner.core.safety.pace import reach

Array = npt.NDArray[np.float64]


class ObstacleWatch:
    """The obstacles that can matter, chosen anew when the arm or the scene has moved.

    Attributes:
        fastest: speed of the scene's fastest obstacle [m/s].
        chose: whether this tick, or `prepare` before it, had to choose from many obstacles.
        chose_ahead: whether that was before the arm's new posture was known.
        margin: distance that links keep from obstacles [m].
        margin_grew: whether the arm is within it because it has grown.
    """

    def __init__(
        self, robot: Robot, parameters: PlannerParameters, limits: Limits,
        constants: RobotConstants, gains: Gains, before: ObstacleWatch | None,
    ) -> None:
        """Prepare for an arm.

        Args:
            robot, parameters: the arm and its planner's.
            limits, constants, gains: made of these.
            before: with other parameters.

        Raises:
            ParameterError: a contact is allowed to a link that the arm does not have.
        """
        margin, of_targets = parameters.clearance_margin, parameters.target_margin
        self._margin = margin
        self._margin_of_targets = margin if of_targets < 0.0 else min(of_targets, margin)
        self._limits = limits
        self._constants, self._gains = constants, gains
        self._course = parameters.clearance_evasion_horizon
        self._contacts = AllowedContacts(parameters.allowed_contacts, robot)
        self._radii = np.array([c.radius for c in robot.capsules])
        self._lead, self._moved = parameters.clearance_lead, robot.moved
        self._gain = parameters.clearance_gain
        self._scene: Scene | None = None
        self.fastest, self.margin_grew = 0.0, False
        self.margin, self._begins = margin, True  # whether no tick has been looked at yet
        self.reset()
        if before is not None:
            self._begins = before._begins
            self.margin_grew = before.margin_grew or before._margin < margin
            if before.margin < before._margin:
                self.margin = min(max(before.margin, self._margin_of_targets), margin)

    def reset(self) -> None:
        """Forget what was chosen, and for which posture."""
        self._arounds: dict[float, Surroundings] = {}  # by the margin
        self._everywhere: tuple[Scene, float, InflatedObstacles] | None = None
        self.chose = self.chose_ahead = self._prepared = False
        # Of the last tick: where the arm was, and the tick's length.
        self._last: tuple[Kinematics, float] | None = None
        # The scene and velocity that `prepare` has dealt with since then.
        self._prepared_for: tuple[Scene, Array] | None = None
        # Velocity, the fastest obstacle, the tick's length, and the reach that follows from them.
        self._reached: tuple[Array, float, float, Array] | None = None
        self.margin, self._begins = self._margin, True

    def _choose_margin(
        self, scene: Scene, arm: Kinematics, previous: Array, dt: float, *, by_target: bool,
    ) -> None:
        """Choose the margin that holds; see `look`."""
        begins, self._begins = self._begins, False
        before, largest, of_targets = self.margin, self._margin, self._margin_of_targets
        if by_target:
            self.margin = of_targets
        elif of_targets < largest and (begins or before < largest):
            around = self._surroundings(scene, arm, previous, dt, largest)
            room = _room(around, arm)
            least = float(room.min(initial=np.inf))
            if begins or self._last is None:
                self.margin = min(max(largest + least, of_targets), largest)
            elif least >= 0.0:
                # Coming nearer at this speed it need not brake for it.
                before_that, ago = self._last
                speed = (_room(around, before_that) - room) / ago
                stop = stopping_time(previous, self._limits.acceleration_max) + dt
                if (speed <= barrier_rate(self._gain, stop, dt) * room).all():
                    self.margin = largest
        self.margin_grew = self.margin_grew or self.margin > before
        if self.margin != before:
            self._prepared_for = None

    def prepare(self, scene: Scene, previous: Array) -> bool:
        """Choose what holds for a while from the last tick's posture and velocity (n,) on.

        Returns:
            Whether there was a choice to make for the next tick.
        """
        if scene is not self._scene:
            self._scene, self.fastest = scene, scene.fastest
            self._prepared = False
        done_for = self._prepared_for
        if self._last is None or (
                done_for and done_for[0] is scene and done_for[1] is previous):
            return self._prepared
        arm, dt = self._last
        self._surroundings(scene, arm, previous, dt, self.margin, to_spare=True)
        self._prepared = self._prepared or self.chose
        self._prepared_for = scene, previous
        return self._prepared

    def look(
        self, scene: Scene, arm: Kinematics, previous: Array, dt: float, *, by_target: bool,
    ) -> Surroundings:
        """Return the obstacles that can matter, for links with their margin.

        A target's margin holds on after it until the larger one asks nothing of the arm: it is
        clear of everything by that, and need not brake for it. An arm that begins within the
        larger one keeps what it has.

        Args:
            scene: all obstacles.
            arm: at the measured posture.
            previous: (n,) velocity of the last tick.
            dt: [s].
            by_target: whether a target commands.
        """
        self.chose_ahead = self.prepare(scene, previous)
        self._choose_margin(scene, arm, previous, dt, by_target=by_target)
        self._last, self._prepared_for = (arm, dt), None
        around = self._surroundings(scene, arm, previous, dt, self.margin)
        self.chose, self._prepared = self.chose or self._prepared, False
        return around

    def everywhere(self) -> InflatedObstacles:
        """Return the obstacles of the last `look`, wherever they are; of very many the nearest.

        The same object while nothing changes.
        """
        around = self._arounds[self.margin]
        if around.complete:
            return around.maps
        known, scene = self._everywhere, around.scene
        if known is None or known[0] is not scene or known[1] != self.margin:
            chosen = around.near if len(scene.names) > MOST_NEAR else np.arange(len(scene.names))
            known = self._everywhere = scene, self.margin, self._kept_from(
                scene, self.margin).inflated(scene, chosen)
        return known[2]

    def _surroundings(
        self, scene: Scene, arm: Kinematics, previous: Array, dt: float, margin: float, *,
        to_spare: bool = False,
    ) -> Surroundings:
        around, self.chose = self._arounds.get(margin), False
        if around is not None and around.scene is scene and around.complete:
            return around
        kept = self._kept_from(scene, margin)
        if len(scene.names) < FEW:
            around = everything(scene, kept, arm)
        else:
            near = self._reach(previous, dt)
            if around is not None and around.hold(scene, arm, near, to_spare=to_spare):
                return around
            self.chose = True
            around = surroundings(scene, kept, arm, near, self._course)
        self._arounds[margin] = around
        return around

    def _reach(self, previous: Array, dt: float) -> Array:
        """Return what `reach` does: the same twice in a tick, for `prepare` and for `look`."""
        known = self._reached
        if known is None or known[0] is not previous or known[1:3] != (self.fastest, dt):
            known = self._reached = previous, self.fastest, dt, reach(
                previous, self.fastest, self._limits, self._constants, self._gains, dt)
        return known[3]

    def _kept_from(self, scene: Scene, margin: float) -> Kept:
        return Kept(self._radii + margin, margin, self._lead,
                    self._contacts.among(scene.names), self._moved)


def _room(around: Surroundings, arm: Kinematics) -> Array:
    """Return how much further than their margin links are from obstacles (…,) [m].

    Pairs that may touch are left out, and links that no joint moves.
    """
    found = link_clearance(around.maps, arm.segment_start, arm.segment_end).distance
    return np.asarray(found[around.maps.moved[:, None] & ~around.maps.may_touch])
