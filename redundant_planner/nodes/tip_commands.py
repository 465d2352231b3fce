"""The commands of an arm with several tips: each has topics of its own, or all hold one object."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.preview import TwistAhead
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.target.goal import Target, TipTargets
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.io.tip_topics import OBJECT
from redundant_planner.nodes.command_input import CommandInput

Array = npt.NDArray[np.float64]


class TipCommands:
    """What is in force of the commands for tips, for all joints, or for what the tips hold.

    It is used like a `CommandInput`. A target of the joints and those of tips end each other.

    Attributes:
        tips: tip → its input.
        held: the object's.
        joints: of all joints.
        coupled: whether the tips hold the object: then its commands count, and not theirs.
    """

    def __init__(
        self, tips: Mapping[str, CommandInput], held: CommandInput, joints: CommandInput,
        warn: Callable[[str], None],
    ) -> None:
        """Begin without a command.

        Args:
            tips, held, joints: the inputs.
            warn: takes a sentence about a message that does not count.
        """
        self.tips, self.held, self.joints, self._warn = dict(tips), held, joints, warn
        self.coupled = False
        self._together: TipTargets | None = None

    @property
    def _all(self) -> tuple[CommandInput, ...]:
        return (*self.tips.values(), self.held, self.joints)

    @property
    def _counts(self) -> tuple[CommandInput, ...]:
        return (self.held,) if self.coupled else (*self.tips.values(), self.joints)

    @property
    def timeout(self) -> float:
        """How old the stamp of a message may be when it arrives [s]."""
        return self.joints.timeout

    @timeout.setter
    def timeout(self, timeout: float) -> None:
        for commands in self._all:
            commands.timeout = timeout

    @property
    def previews(self) -> int:
        """How many previews were taken: there is no topic for them."""
        return 0

    def forget(self) -> None:
        """Drop all commands: motion begins with a new one."""
        for commands in self._all:
            commands.forget()

    def forget_target(self) -> None:
        """Let go of all targets."""
        for commands in self._all:
            commands.forget_target()

    def forget_preview(self) -> None:
        """Do nothing: there are no previews."""

    @property
    def has_target(self) -> bool:
        """Whether a target commands the arm."""
        return any(commands.has_target for commands in self._counts)

    @property
    def known_target(self) -> Target | TipTargets | None:
        """The target or those of tips; None without one, or before its first tick."""
        if self.coupled:
            return self.held.known_target
        if self.joints.known_target is not None:
            return self.joints.known_target
        found = {tip: commands.known_target for tip, commands in self.tips.items()}
        return found if any(found.values()) else None  # type: ignore[return-value]

    def target(self, places: Poses) -> Target | TipTargets | None:
        """Return where the arm shall go; None if twists alone command.

        Args:
            places: where the tips should be now, or the object.
        """
        if self.coupled:
            return self.held.target(places)
        target = self.joints.target(places)
        if target is not None:
            return target
        found = {tip: commands.target(Poses.of(place)) for (tip, commands), place in zip(
            self.tips.items(), places.each)}
        if not any(found.values()):
            self._together = None
        elif self._together is None or any(
                self._together[tip] is not at for tip, at in found.items()):
            self._together = found  # type: ignore[assignment]
        return self._together

    def take_news(self) -> tuple[Sighting, ...]:
        """Return the targets that came since the last call."""
        if self.coupled:
            return self.held.take_news()
        if self.joints.has_target:
            return self.joints.take_news()
        return tuple(
            Sighting({tip: seen.target}, seen.age)  # type: ignore[dict-item]
            for tip, commands in self.tips.items() for seen in commands.take_news())

    def age(self) -> float:
        """Return how long ago the latest twist came [s], infinite without one."""
        return min(commands.age() for commands in self._counts)

    def moves(self, timeout: float) -> bool:
        """Return whether a twist that is not older than `timeout` moves a tip, or the object."""
        return any(commands.moves(timeout) for commands in self._counts)

    def twist(self, timeout: float, places: Callable[[], Poses]) -> Array:
        """Return the twists (t, 6) of the tips in command axes, or that of the object (6,).

        Args:
            timeout: what is older counts as zero [s].
            places: returns where the tips are, or the object.
        """
        if self.coupled:
            return self.held.twist(timeout, places)
        return np.array([
            commands.twist(timeout, lambda t=t: Poses.of(places().each[t]))  # type: ignore[misc]
            for t, commands in enumerate(self.tips.values())])

    def ahead(self, timeout: float) -> TwistAhead | None:
        """Return None: nothing announces twists."""
        return None

    def preview_elapsed(self) -> float:
        """Return 0: there are no previews."""
        return 0.0

    def on_tip(
        self, tip: str, topic: str, take: Callable[[CommandInput, bytes], None],
    ) -> Callable[[bytes], None]:
        """Return who takes the messages of a tip's topic, or of the object's.

        Args:
            tip: which, or `OBJECT`.
            topic: of the messages, for the log.
            take: takes one with the tip's input.
        """
        def on_message(raw: bytes) -> None:
            if (tip == OBJECT) != self.coupled:
                self._warn(f'{topic} ignored: the tips are ' + (
                    f'coupled, and {OBJECT}/… moves them (~/couple with false ends that)'
                    if self.coupled else 'not coupled (~/couple)'))
                return
            take(self.held if tip == OBJECT else self.tips[tip], raw)
            self.joints.forget_target()

        return on_message

    def on_joint_target(self, raw: bytes, robot: Robot, posture: Array | None) -> None:
        """Take a serialised target of the joints, see `CommandInput`."""
        self._take_joints('target_joints', lambda: self.joints.on_joint_target(
            raw, robot, posture))

    def on_trajectory(self, raw: bytes, robot: Robot, posture: Array | None) -> None:
        """Take a serialised chunk of joint positions, see `CommandInput`."""
        self._take_joints('target_trajectory', lambda: self.joints.on_trajectory(
            raw, robot, posture))

    def _take_joints(self, topic: str, take: Callable[[], None]) -> None:
        if self.coupled:
            self._warn(f'{topic} ignored: the tips are coupled, and joints of their own would '
                       'tear what they hold')
            return
        take()
        if self.joints.has_target:
            for commands in self.tips.values():
                commands.forget()
