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
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.safety.pace import reach

Array = npt.NDArray[np.float64]


class ObstacleWatch:
    """The obstacles that can matter, chosen anew when the arm or the scene has moved.

    Attributes:
        fastest: speed of the scene's fastest obstacle [m/s].
        chose: whether this tick, or `prepare` before it, had to choose from many obstacles.
        chose_ahead: whether that was before the arm's new posture was known.
        margin_grew: whether the arm is within the margin because that has grown.
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
        self._kept = Kept(
            self._radii + margin, margin, parameters.clearance_lead, moved=robot.moved)
        self.margin_grew: bool = before is not None and (
            before.margin_grew or before._margin < margin)
        self._scene: Scene | None = None
        self.fastest = 0.0
        self.reset()

    def reset(self) -> None:
        """Forget what was chosen, and for which posture."""
        self._around: Surroundings | None = None
        self._everywhere: tuple[Scene, InflatedObstacles] | None = None
        self.chose = self.chose_ahead = self._prepared = False
        # Of the last tick: where the arm was, and the tick's length.
        self._last: tuple[Kinematics, float] | None = None
        # The scene and velocity that `prepare` has dealt with since then.
        self._prepared_for: tuple[Scene, Array] | None = None
        # Velocity, the fastest obstacle, the tick's length, and the reach that follows from them.
        self._reached: tuple[Array, float, float, Array] | None = None
        self._keep(self._margin_of_targets)

    @property
    def margin(self) -> float:
        """What links with it keep from obstacles [m]."""
        return self._kept.margin

    def _keep(self, margin: float) -> None:
        if margin != self.margin:
            self._kept = self._kept._replace(radii=self._radii + margin, margin=margin)
            self._around = self._everywhere = self._prepared_for = None

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
        self._surroundings(scene, arm, previous, dt, to_spare=True)
        self._prepared = self._prepared or self.chose
        self._prepared_for = scene, previous
        return self._prepared

    def look(
        self, scene: Scene, arm: Kinematics, previous: Array, dt: float, *, by_target: bool,
    ) -> Surroundings:
        """Return the obstacles that can matter, for links with their margin.

        A target's margin holds on after it until the arm is clear of everything by the larger one.

        Args:
            scene: all obstacles.
            arm: at the measured posture.
            previous: (n,) velocity of the last tick.
            dt: [s].
            by_target: whether a target commands.
        """
        if by_target:
            self._keep(self._margin_of_targets)
        self.chose_ahead = self.prepare(scene, previous)
        self._last, self._prepared_for = (arm, dt), None
        around = self._surroundings(scene, arm, previous, dt)
        if not by_target and self.margin < self._margin and _is_clear(
                around, arm, self._margin - self.margin):
            self._keep(self._margin)
            around = self._surroundings(scene, arm, previous, dt)
        self.chose, self._prepared = self.chose or self._prepared, False
        return around

    def everywhere(self) -> InflatedObstacles:
        """Return the obstacles of the last `look`, wherever they are; of very many the nearest.

        The same object while nothing changes.
        """
        around = self._around
        assert around is not None
        if around.complete:
            return around.maps
        if self._everywhere is None or self._everywhere[0] is not around.scene:
            scene = around.scene
            chosen = around.near if len(scene.names) > MOST_NEAR else np.arange(len(scene.names))
            self._everywhere = scene, self._kept_from(scene).inflated(scene, chosen)
        return self._everywhere[1]

    def _surroundings(
        self, scene: Scene, arm: Kinematics, previous: Array, dt: float, *,
        to_spare: bool = False,
    ) -> Surroundings:
        around, self.chose = self._around, False
        if around is not None and around.scene is scene and around.complete:
            return around
        if len(scene.names) < FEW:
            self._around = everything(scene, self._kept_from(scene), arm)
            return self._around
        near = self._reach(previous, dt)
        if around is None or not around.hold(scene, arm, near, to_spare=to_spare):
            self.chose = True
            self._around = around = surroundings(
                scene, self._kept_from(scene), arm, near, self._course)
        return around

    def _reach(self, previous: Array, dt: float) -> Array:
        """Return what `reach` does: the same twice in a tick, for `prepare` and for `look`."""
        known = self._reached
        if known is None or known[0] is not previous or known[1:3] != (self.fastest, dt):
            known = self._reached = previous, self.fastest, dt, reach(
                previous, self.fastest, self._limits, self._constants, self._gains, dt)
        return known[3]

    def _kept_from(self, scene: Scene) -> Kept:
        return self._kept._replace(contacts=self._contacts.among(scene.names))


def _is_clear(around: Surroundings, arm: Kinematics, distance: float) -> bool:
    """Return whether links are further from obstacles than this [m], besides their margin.

    Pairs that may touch do not count.
    """
    found = link_clearance(around.maps, arm.segment_start, arm.segment_end).distance
    return bool((found[~around.maps.may_touch] >= distance).all()
                and (around.range >= distance).all())
