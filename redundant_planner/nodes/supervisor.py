"""Decides in each tick whether the arm may move, and says why not. No ROS, no clock of its own.

The node tells the supervisor of everything that bears on the decision, as it happens: measured
postures, other publishers, requests of the operator, faults. Times are seconds of the loop's
clock; nothing here reads a clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known
from redundant_planner.core.safety.position_command import has_jumped

Array = npt.NDArray[np.float64]

# How long the arm waits before it first moves, and listens for another node that commands it [s].
LISTENING = 1.0
# If the arm moves further than this meanwhile, another node commands it [rad, m].
MOVED_BY_OTHERS = 5e-3
# After a longer time without a tick the motion starts again from the measured posture [s].
LONGEST_GAP = 1.0
# A command after a pause of this length is a fresh one [s].
FRESH_AFTER = 0.3
# Publishers of the joints find their way to this node within this, one after the other [s].
_FOUND_WITHIN = 1.0
_MOVED = 'something else has moved the arm: it stays where it is'
# Why a paused arm is held.
PAUSED = 'paused'
# The answer to who pauses a planner that somebody has paused before.
PAUSED_ALREADY = 'paused already: the arm is left to others'

_ALL = slice(None)


class Decision(NamedTuple):
    """What the arm may do in a tick.

    Attributes:
        hold: why the arm must come to rest and stay there; empty if it may move.
        is_fault: whether `hold` is a fault, rather than the start or the operator's wish.
        ignore_command: why the command counts as zero although the arm may move; empty if it
            counts.
        time_jumped: whether earlier times mean nothing any more.
        warning: for the log; empty if there is nothing to say.
    """

    hold: str = ''
    is_fault: bool = False
    ignore_command: str = ''
    time_jumped: bool = False
    warning: str = ''


class Supervisor:
    """Collects what bears on the arm's permission to move; `decide` draws the conclusion.

    Attributes:
        posture: (n,) the latest measurement of each joint [rad, m]; None before all have one.
        failure: the fault that holds the arm until `reset`; empty without one.
        astray: why the arm does not follow; empty if it does.
        tries: whether it may try again, gently.
        was_moved: whether something else has moved the standing arm, and nobody has commanded it
            since.
        listening: whether the arm has not been allowed to move yet, so that a command on its topic
            comes from another node.
    """

    def __init__(
        self, velocity_max: Array, position_tolerance: float, joint_names: Sequence[str] = (),
    ) -> None:
        """Begin without a measurement.

        Args:
            velocity_max: (n,) the joints' limits [rad/s, m/s].
            position_tolerance: a measured posture that is further from the one before than the
                arm can travel, plus this, is a jump [rad, m].
            joint_names: of the n joints, for sentences.
        """
        self.posture: Array | None = None
        self.failure = ''
        self.listening = True
        self._velocity_max = velocity_max
        self._position_tolerance = position_tolerance
        self._names = joint_names
        self._measured_at = np.full(len(velocity_max), -np.inf)  # each joint
        self._heard_at = np.inf  # when a joint of the arm was measured for the first time
        self._others: Sequence[str] = ()
        # Where the arm was when listening began, and until when it goes on.
        self._first_posture: Array | None = None
        self._listen_until = np.inf
        self._last_tick = -np.inf
        self._restart = ''
        self._reset_wanted = False
        self._paused = False
        # A pause that no tick has heeded yet; it counts even if it has ended before.
        self._pause_due = False
        self._command_publishers: Sequence[str] = ()
        self._twist_publishers: Sequence[str] = ()
        self.astray = ''
        self.tries = False
        self._quiet_since = np.inf  # when the last command ended
        self.was_moved = False

    def measured(
        self, posture: Array, now: float, which: npt.NDArray[np.intp] | slice = _ALL,
    ) -> None:
        """Take a measured posture, and see whether the arm has jumped.

        Args:
            posture: (n,) the latest of each joint [rad, m]; NaN where there is none yet.
            now: [s].
            which: (k,) the joints that were measured now; all of them if left out.
        """
        self._heard_at = min(self._heard_at, now)
        if self.posture is None and np.isnan(posture).any():
            self._measured_at[which] = now
            return
        if self._first_posture is None or (self.listening and float(
                np.abs(posture - self._first_posture).max()) > MOVED_BY_OTHERS):
            # The middleware finds other nodes at about the time it finds the arm. An arm in motion
            # is commanded by a node that it may not have found yet.
            self._first_posture, self._listen_until = posture, now + LISTENING
        elif not self.listening and self.posture is not None and has_jumped(
                self.posture, posture, self._velocity_max, now - self._measured_at,
                self._position_tolerance):
            self._restart = 'joint_states jumped: the motion starts again from where the arm is'
        self.posture = posture
        self._measured_at[which] = now

    @property
    def heard_of_arm(self) -> bool:
        """Whether any joint of the arm has been measured."""
        return bool(np.isfinite(self._heard_at))

    @property
    def heard_of_others(self) -> bool:
        """Whether joint_states of other joints than the arm's have come."""
        return bool(self._others)

    def heard_others(self, joint_names: Sequence[str]) -> None:
        """Note joint_states of other joints than the arm's."""
        self._others = joint_names

    def does_not_follow(self, reason: str) -> None:
        """Stop an arm that does not do what it is told, until a fresh command comes."""
        self.astray, self.tries, self._quiet_since = reason, False, np.inf

    def follows(self) -> None:
        """Note that the arm follows again."""
        self.astray, self.tries = '', False

    def moved_by_others(self) -> None:
        """Have a standing arm that was moved by something else stay where it is.

        It is left alone until somebody commands it: whichever controller has moved it may go on.
        """
        self.was_moved = True

    def heard_a_wish(self, wishes: bool, now: float, at_rest: bool) -> None:
        """Note whether somebody commands the arm [s].

        A standing arm that did not follow tries again with a command that comes after a pause: a
        stick that was held all the time must not move it once its controller wakes up.
        """
        if not wishes:
            self._quiet_since = min(self._quiet_since, now)
        elif self.astray and at_rest and now - self._quiet_since >= FRESH_AFTER:
            self.tries = True
        if wishes:
            self._quiet_since, self.was_moved = np.inf, False

    def heard_a_command(self, now: float) -> None:
        """Note a command on the arm's topic while this node is silent: another node's [s]."""
        if self.listening:
            self._listen_until = now + LISTENING

    def found_publishers(self, of_commands: Sequence[str], of_twists: Sequence[str]) -> None:
        """Take the names of all nodes that publish joint_command, this one included, and cmd_vel.

        A joint_command from a second node stops the arm; so does a second sender of cmd_vel, as
        twists from two senders are not mixed.
        """
        self._command_publishers, self._twist_publishers = of_commands, of_twists

    def pause(self, paused: bool) -> str:
        """Leave the arm to others, or take it back; return the answer to the operator."""
        if paused and self._paused:
            return PAUSED_ALREADY
        self._paused = paused
        self._pause_due = self._pause_due or paused
        return ('paused: the arm comes to rest without its target, left to others' if paused
                else 'resumed from where the arm is')

    def reset(self) -> str:
        """Have the motion start again from the measured posture, after a fault too.

        Returns:
            The answer to the operator.
        """
        self._restart = 'reset: the motion starts again from where the arm is'
        self.tries = bool(self.astray)
        self._reset_wanted = bool(self.failure)
        return self._restart

    def fail(self, reason: str) -> None:
        """Hold the arm until `reset`; of several reasons the first one counts."""
        self.failure = self.failure or reason

    def recovery_due(self, at_rest: bool) -> bool:
        """Return once, after a reset, whether the caller may now recover from a failure."""
        due = self._reset_wanted and at_rest
        self._reset_wanted = self._reset_wanted and not due
        return due

    def recovered(self) -> None:
        """Forget the failure: the caller has dropped whatever led to it."""
        self.failure = ''

    def first_motion_within(self, now: float, seconds: float) -> bool:
        """Return whether the arm may move for the first time within some seconds [s]."""
        return self.listening and now < self._listen_until <= now + seconds

    def measurement_ages(self, now: float) -> Array:
        """Return how old each joint's measurement is (n,) [s]; infinite where one has none."""
        return now - self._measured_at

    def decide(self, now: float, at_rest: bool, joint_state_timeout: float) -> Decision:
        """Return what the arm may do in the tick that begins now.

        Args:
            now: [s].
            at_rest: whether no command that moves the arm is in force.
            joint_state_timeout: an older measurement is none [s].
        """
        time_jumped = self._note_time(now)
        if self.failure:
            decision = Decision(self.failure, is_fault=True)
        else:
            decision = (self._start(now) or self._fault(now, at_rest, joint_state_timeout)
                        or self._wishes())
        self._pause_due = False
        return decision._replace(time_jumped=time_jumped)

    def _note_time(self, now: float) -> bool:
        """Note a tick; return whether the clock jumped or the process slept since the last one."""
        gap, self._last_tick = now - self._last_tick, now
        if not np.isfinite(gap) or 0.0 <= gap <= LONGEST_GAP:
            return False
        self._restart = f'the clock jumped by {gap:.3f} s: the motion starts again'
        # Times in the future would stay young for ever.
        self._measured_at = np.minimum(self._measured_at, now)
        self._heard_at = min(self._heard_at, now) if np.isfinite(self._heard_at) else np.inf
        self._listen_until = min(self._listen_until, now + LISTENING)
        return True

    def _start(self, now: float) -> Decision | None:
        """Return why the arm must wait for its first motion, if it must."""
        if self.posture is None:
            return self._waits(now)
        if self.listening and now < self._listen_until:
            return Decision('listening whether another node commands this arm')
        self.listening = False
        return None

    def _waits(self, now: float) -> Decision:
        """Say which joints the arm waits for."""
        missing = self._measured_at == -np.inf
        if missing.all():
            if not self._others:
                return Decision('waiting for joint_states')
            return Decision(f'waiting for joint_states of {self._named(missing)}; those that '
                            f'come are of {known(self._others)}')
        what = f'waiting for joint_states of {self._named(missing)}'
        age = now - self._heard_at
        missing_for = f'{what}: missing for {age:.1f} s'
        return Decision(missing_for, warning=missing_for if age > _FOUND_WITHIN else '')

    def _named(self, joints: npt.NDArray[np.bool_]) -> str:
        return known(name for name, named in zip(self._names, joints) if named)

    def _fault(self, now: float, at_rest: bool, joint_state_timeout: float) -> Decision | None:
        """Return which fault stops the arm, if one does."""
        age = float(self.measurement_ages(now).max())
        if age > joint_state_timeout:
            late = self.measurement_ages(now) > joint_state_timeout
            what = 'no usable joint_states' + (
                '' if late.all() else f' of {self._named(late)}')
            return Decision(
                f'{what} for {age:.1f} s', is_fault=True,
                warning=f'{what} for {joint_state_timeout:g} s: stopped')
        # An arm that leaps as it is commanded has jumped, too.
        if self.astray and not self.tries:
            return Decision(self.astray, is_fault=True, warning=self.astray)
        if self._restart and not at_rest:
            return Decision(self._restart, is_fault=True, warning=self._restart)
        self._restart = ''
        if self.was_moved:
            return Decision(_MOVED, warning='' if at_rest else _MOVED)
        if len(self._command_publishers) > 1:
            reason = _several('joint_command', self._command_publishers)
            return Decision(reason, is_fault=True,
                            warning=f'{reason}; stopped until only one is left')
        return None

    def _wishes(self) -> Decision:
        """Return what the operator asks for: a pause, or motion by one sender's twists."""
        if self._paused or self._pause_due:
            return Decision(PAUSED)
        if len(self._twist_publishers) > 1:
            reason = (f'{_several("cmd_vel", self._twist_publishers, "which are not mixed")}; '
                      'stop all but one, or use twist_mux')
            return Decision(ignore_command=reason, warning=reason)
        return Decision()


def _several(topic: str, publishers: Sequence[str], remark: str = '') -> str:
    """Return the sentence about a topic with several publishers."""
    return (f'{topic} has {len(publishers)} publishers{", " if remark else ""}{remark}: '
            f'{", ".join(publishers)}')
