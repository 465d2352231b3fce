"""One arm of the page: what is heard of it, how it is drawn, and its ghost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import viser

from redundant_planner.core.errors import ParameterError, PlannerError
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.link_surfaces import link_surfaces, LinkSurface
from redundant_planner.playground.arm_view import ArmView, GHOST, LinksView
from redundant_planner.playground.figures_view import figures_html, tallies_html
from redundant_planner.playground.ghost import Ghost
from redundant_planner.playground.measures import nearest_pair, NearestPair, Tally
from redundant_planner.playground.planner_client import PlannerClient

Array = npt.NDArray[np.float64]


class ShownArm:
    """An arm, from what its planner says to what the page shows.

    Attributes:
        client: hears the planner.
        arm: the posture at the last look; None while there is none.
        says: why the arm, or its ghost, cannot be shown; empty if they can.
    """

    def __init__(
        self, server: viser.ViserServer, client: PlannerClient, folder: Path | None,
    ) -> None:
        """Prepare.

        Args:
            server: of the page.
            client: hears the planner.
            folder: of the URDF, for its meshes; None if it is not known.
        """
        self.client, self.says = client, ''
        self.arm: Kinematics | None = None
        self._server, self._folder = server, folder
        self._scene_name = f'/arms{client.namespace or "/arm"}'
        self._view: ArmView | None = None
        self._robot: Robot | None = None
        self._near: NearestPair | None = None
        self._shown = (True, False)
        self._ghost: tuple[str, Ghost, LinksView, Tally] | None = None

    def look(self, now: float) -> None:
        """Take in what has come, and draw it."""
        client = self.client
        client.look()
        robot, motion = client.robot, client.motion
        if robot is None or motion is None:
            return
        if robot is not self._robot:
            self._draw_anew(robot)
        assert self._view is not None
        self.arm = robot.kinematics(motion.measured)
        self._near = nearest_pair(robot, self.arm, client.scene)
        self._view.show(self.arm, self._near, client.reference)
        if self._ghost is not None:
            self._follow(now)

    def _draw_anew(self, robot: Robot) -> None:
        self.remove()
        self._robot, self.says = robot, ''
        surfaces: tuple[LinkSurface, ...] = ()
        try:
            surfaces = link_surfaces(robot, self._folder)
        except (PlannerError, ValueError, RuntimeError) as error:
            self.says = f'the links are drawn as capsules: {str(error).splitlines()[0]}'
        self._view = ArmView(self._server.scene, self._scene_name, robot, surfaces)
        self.show(*self._shown)

    def show(self, links: bool, capsules: bool) -> None:
        """Show links, capsules or both."""
        self._shown = links, capsules
        if self._view is not None:
            self._view.links.show(links=links, capsules=capsules)

    def forget(self) -> None:
        """Begin new trails."""
        if self._view is not None:
            self._view.forget()

    def compare(self, method: str, now: float) -> None:
        """Begin a ghost by a method here, or end it; the method is empty for none."""
        if self._ghost is not None:
            self._ghost[2].remove()
            self._ghost = None
        robot, motion = self.client.robot, self.client.motion
        if not method or robot is None or motion is None:
            return
        if len(robot.tips) > 1:
            self.says = 'no ghost: there is none of a body with several tips'
            return
        try:
            ghost = Ghost(robot, self.client.parameters, method, motion.measured, now)
        except ParameterError as error:
            self.says = f'no ghost: {error}'
            return
        view = LinksView(self._server.scene, f'{self._scene_name}_ghost', robot, (),
                         color=GHOST, opacity=0.4)
        self._ghost = method, ghost, view, Tally(motion.measured)

    def _follow(self, now: float) -> None:
        """Move the ghost, and count for both."""
        assert self._ghost is not None and self._robot is not None
        assert self.client.motion is not None
        _, ghost, view, real = self._ghost
        try:
            ghost.follow(self.client.commanded_twist, self.client.commanded_target,
                         self.client.scene, now)
        except PlannerError as error:
            self.compare('', now)
            self.says = f'the ghost ended: {error}'
            return
        view.move(self._robot.kinematics(ghost.q))
        real.take(self.client.motion.measured,
                  np.inf if self._near is None else self._near.distance)

    @property
    def figures(self) -> str:
        """The live figures as HTML; empty while the arm is not there."""
        robot, motion = self.client.robot, self.client.motion
        if robot is None or motion is None:
            return ''
        text = figures_html(robot, motion, self.client.status, self._near, self.client.target)
        if self._ghost is not None:
            method, ghost, _, real = self._ghost
            text += tallies_html(real, ghost.tally, method)
        return text

    def remove(self) -> None:
        """Take it off the page."""
        if self._ghost is not None:
            self._ghost[2].remove()
            self._ghost = None
        if self._view is not None:
            self._view.remove()
            self._view = None
        self._robot = None
