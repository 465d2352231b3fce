"""Whether the arm does what it is told: what was commanded against what was measured.

A drive answers late: by its lag, its dead time, and the age of joint_states. A joint that is late
by a dead time and a lag of first order is behind by

    ∫ w(s) |q̇(t − s)| ds at most, w = 1 within the dead time, e^(−(s − dead time)/lag) after it

for any motion. So each joint may be behind by that, for `DEAD_TIME` and `LAG`, and by a tolerance.
What it is behind by otherwise is lost: no controller carries it out, it has another order of
joints, or the hardware stands still.

    lost ← lost · e^(−dt/3 s) + q̇ dt, then less by 1.1 times what the joint has moved that way
    owed ← owed + q̇ dt, less by what the joint has moved

So a gain that is off by a tenth loses nothing, nor does motion against the command, as of a push.
But what a late joint has caught up with by its tenth more would be lost as soon as the command
turns round. So it is behind by the smaller of both, and by nothing where they differ in sign. Of
what is owed, all that lateness does not explain is forgotten like what is lost.
Nothing is known of a joint between its measurements: it is judged when one comes.

Joints in another order do not wait until one is behind: a joint that is late is somewhere on the
way that it was told, and one that does what another was told is not (`_disorder`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, OutMatrix, OutVector, Vector

Array = npt.NDArray[np.float64]

# How late measurements and drives may be, besides the drive's lag and dead time as they are known
# [s]: a drive with 80 ms of lag and 40 ms of dead time, and states at 20 Hz that are 0.1 s old.
DEAD_TIME, LAG = 0.2, 0.09
# What joints lose, and what others move them by at rest, is forgotten in this time; what they move
# without a command in this: a push does not count for long [s].
_FORGETTING, _FORGETTING_MOVES = 3.0, 0.5
# How much more than a joint has moved is taken to be done, and how much further than it was told
# an arm goes at most: one that is pushed goes further.
_GAIN = 1.1
# Measured motion within this is noise [rad, m].
_NOISE = 2.5e-3
# An arm that moves so far without a command so soon after the first one takes it for another
# joint's, or was elsewhere for its controller: positions make it leap [rad, m], [s].
_LEAP, _JUST_BEGUN = 0.1, 0.3
# A joint that was told to move so far, and has done so by this share, follows; one that was told
# three times as much and has not does not [rad, m]. Joints that were told less than the second
# share of what was told most are too slow to tell.
_FIRST_MOTION, _FIRST_SHARE, _SLOW_SHARE = 0.01, 0.3, 0.25
# Joints seem to be in another order where what they moved by is nearer by more than this factor to
# what they were told, each taken for another, than each taken for itself. That shows in the
# beginning of a motion [rad, m].
_NEARER, _BEGINNING = 5.0, 0.6
# Joints that have moved by less than this share of the one that moved furthest are not named.
_HARDLY = 0.1

# What to check where a joint moves without a command: another one than the one that stays behind,
# or the same one, against its command.
_WHO_MOVES_IT = ("does the controller have the joints in another order than this planner's, is "
                 'the load more than the drives can hold, or does something else move the arm?')
_WHAT_PULLS_IT = 'is the load more than the drives can hold, or does something else move the arm?'

# Rows of the state: what was lost and what is owed; what was moved without a command, and that
# without forgetting; the measurement without its noise; the travel told within the dead time,
# before it with the weights of the lag, and of late; where the arm began, or stood; and since then
# all that was told and done, how far from there it was told to be, and least and most of that
# [rad, m].
(_LOST, _OWED, _BESIDE, _AWAY, _MEASURED, _WITHIN, _BEFORE, _RECENT, _STOOD, _TOLD, _DONE,
 _SHIFT, _LEAST, _MOST) = range(14)


class Following:
    """Watches one arm from the moment at which it begins to move.

    Attributes:
        tolerance: how far a joint may be behind besides [rad, m]; 0 for any distance.
        moves_alone: whether a joint of late has moved without a command.
        sets_off: whether the arm has not been seen to move since it stood.
    """

    def __init__(self, joint_names: Sequence[str], dt: float, tolerance: float) -> None:
        """Prepare for n joints and ticks of dt [s]."""
        self.tolerance, self.moves_alone, self.sets_off = tolerance, False, True
        self._names, self._dt = joint_names, dt
        self._state = np.zeros((14, len(joint_names)))
        self._travels = np.zeros((1, len(joint_names)))
        self._at = self._begins = 0
        self._disorder = 0.0  # summed up over what was told since the arm stood [rad, m]
        self._lag = LAG

    def begin(self, measured: Array, lag: float = 0.0, dead_time: float = 0.0) -> None:
        """Begin anew with an arm at rest.

        Args:
            measured: (n,) where it is [rad, m].
            lag, dead_time: of its drives, as far as they are known [s].
        """
        self._state[:] = 0.0
        self._state[_MEASURED] = self._state[_STOOD] = measured
        self._disorder, self.sets_off = 0.0, True
        self._lag = LAG + lag
        ticks = round((DEAD_TIME + dead_time) / self._dt) + 1
        self._travels, self._at = np.zeros((ticks, len(measured))), 0
        self._begins = round(_JUST_BEGUN / self._dt)

    def rest(self) -> None:
        """Count from here what the arm is moved by without a command."""
        self._state[_AWAY] = 0.0

    def slept(self) -> None:
        """Note that nothing was commanded for a while: the arm may have gone on meanwhile."""
        self._begins = 0
        self.rest()

    @property
    def travel(self) -> Array:
        """By how much each joint may be behind that is late (n,) [rad, m]."""
        return self._state[_WITHIN] + self._state[_BEFORE]

    @property
    def moved_by_others(self) -> float:
        """How far the farthest joint has moved without a command since `rest` [rad, m]."""
        return float(np.abs(self._state[_AWAY]).max())

    @property
    def has_followed(self) -> bool:
        """Whether the joints have done their first motion, those that were told much."""
        told, done = self._state[_TOLD], self._state[_DONE]
        most = float(told.max())
        return most >= _FIRST_MOTION and bool(
            (done >= _FIRST_SHARE * told)[told >= _SLOW_SHARE * most].all())

    def tick(self, dq: Array, measured: Array, ages: Array, *, tries: bool = False) -> str:
        """Take a tick; say which joints do not follow, if any does not.

        Args:
            dq: (n,) velocity that has been commanded since the last tick [rad/s, m/s].
            measured: (n,) where the arm is [rad, m].
            ages: (n,) since when each joint was, zero if it was measured since the last tick [s].
            tries: whether the arm is to show by a small motion that it follows.
        """
        at, self._at = self._at, (self._at + 1) % len(self._travels)
        self._begins -= 1
        late, self.moves_alone, stands, disorder = _watch(
            self._state, self._travels[at], dq, measured, ages, self.tolerance, self._lag,
            self._dt)
        self._disorder = max(self._disorder + disorder, 0.0)
        other_order = ''
        if 0.0 < self.tolerance < self._disorder:
            self.moves_alone, other_order = True, self._words_of_an_order(measured)
        if stands and not tries:
            self._state[_STOOD], self._state[_TOLD:] = measured, 0.0
            self._disorder, self.sets_off = 0.0, True
        elif self.sets_off:
            self.sets_off = not self.has_followed
        if self.tolerance <= 0.0:
            return ''
        if other_order:
            return other_order
        if late or (tries and self._has_not_followed(ages)):
            return self._words()
        return self._words_of_a_leap() if self._begins > 0 and self._leaps else ''

    def _has_not_followed(self, ages: Array) -> bool:
        """Return whether a joint has not done its first motion, as measured just now."""
        told, done = self._state[_TOLD], self._state[_DONE]
        return bool(((told >= 3.0 * _FIRST_MOTION) & (done < _FIRST_SHARE * told)
                     & (ages <= 0.0)).any())

    def _words_of_an_order(self, measured: Array) -> str:
        told, moved = self._state[_SHIFT], measured - self._state[_STOOD]
        off = np.abs(moved - told * np.sqrt((moved @ moved) / max(told @ told, _NOISE**2)))
        pairs = ', '.join(
            f"joint '{self._names[i]}' moves as '{self._names[j]}' was told"
            for i, j in sorted(zip(moved.argsort().tolist(), told.argsort().tolist()))
            if off[i] > _HARDLY * off.max() and abs(moved[i]) > _HARDLY * np.abs(moved).max())
        return (f'the arm does not follow: {pairs}, {off.max():.3f} rad or m off; '
                f'{_WHO_MOVES_IT}')

    @property
    def _behind(self) -> Array:
        return np.array([_behind(self._state, i) for i in range(len(self._names))])

    @property
    def _leaps(self) -> bool:
        """Whether a joint of late has moved far without a command."""
        far = max(_LEAP, self.tolerance)
        return bool((np.abs(self._state[_BESIDE]) > far + self._state[_RECENT]).any())

    @property
    def _movers(self) -> list[int]:
        """The joints that move without a command, the farthest first."""
        beside = np.abs(self._state[_BESIDE])
        return [int(j) for j in np.argsort(-beside)
                if beside[j] > self.tolerance + self._state[_RECENT, j]]

    def _named(self, joints: Sequence[int]) -> str:
        return ', '.join(f"'{self._names[j]}'" for j in joints)

    def _words_of_a_leap(self) -> str:
        far = float(np.abs(self._state[_BESIDE]).max())
        return (f'the arm does not follow: joint {self._named(self._movers)} moved by up to '
                f'{far:.3f} rad or m without a command as soon as the arm was commanded; '
                f'{_WHO_MOVES_IT}')

    def _words(self) -> str:
        behind, movers = self._behind, self._movers
        least = min(self.tolerance, float(behind.max()))
        late = [int(i) for i in np.argsort(-behind) if behind[i] >= least]
        stand = ', '.join(f"joint '{self._names[i]}' stays behind by {behind[i]:.3f}"
                          for i in late)
        if not movers:
            return (f'the arm does not follow: {stand} rad or m; is its controller active, does '
                    'it listen to this output, does the hardware move, can its drives move the '
                    'load, or does something hold it?')
        # Where two are swapped, one that stays behind is another than the one that moves.
        swapped = not set(late) & set(movers)
        return (f'the arm does not follow: {stand} rad or m, while joint {self._named(movers)} '
                f'moves without a command; {_WHO_MOVES_IT if swapped else _WHAT_PULLS_IT}')


@compiled
def _behind(state: OutMatrix, i: int) -> float:
    """Return how far joint i is behind [rad, m]."""
    lost, owed = state[_LOST, i], state[_OWED, i]
    return min(abs(lost), abs(owed)) if lost * owed > 0.0 else 0.0


@compiled
def _of_what_is_left(moved: float, left: float) -> float:
    """Return how much of a motion goes towards what is left of another [rad, m]."""
    return min(max(moved, -abs(left)), abs(left)) if moved * left > 0.0 else 0.0


@compiled
def _is_elsewhere(state: OutMatrix, moved: Vector, tolerance: float) -> bool:
    """Return whether a joint is further than a tolerance from all places on its way [rad, m].

    Whatever is late is on its way, each joint as late as it may be.
    """
    elsewhere = False
    for i in range(len(moved)):
        elsewhere = elsewhere or moved[i] > state[_MOST, i] + tolerance or (
            moved[i] < state[_LEAST, i] - tolerance)
    return elsewhere


@compiled
def _disorder(told: Vector, moved: Vector) -> float:
    """Return how much joints seem to be in another order, 1 at most, 0 if that cannot be told.

    Of all orders, that in which the joint that moved furthest is the one that was told most, and
    so on, leaves the smallest sum of squares (the rearrangement inequality). An arm that is late
    has done a part of what it was told.

    Args:
        told, moved: (n,) how far the joints were told to go, and have gone [rad, m].
    """
    far, asked = (moved * moved).sum(), (told * told).sum()
    if asked <= 0.0 or far > _GAIN**2 * asked or asked > _BEGINNING**2:
        return 0.0
    share = np.sqrt(far / asked)
    apart = moved - share * told
    off = (apart * apart).sum()
    if off <= 0.0:
        return 0.0
    apart = np.sort(moved) - share * np.sort(told)
    return 1.0 - _NEARER * np.sqrt((apart * apart).sum() / off)


@compiled
def _watch(
    state: OutMatrix, travels: OutVector, dq: Vector, measured: Vector, ages: Vector,
    tolerance: float, lag: float, dt: float,
) -> tuple[bool, bool, bool, float]:
    """Bring the state up to date.

    Returns whether a joint does not follow, whether one moves alone, whether all stand, and the
    joints' disorder times how far they were told to move [rad, m].

    Args:
        state: of `Following`.
        travels: (n,) what was told in the tick that leaves the dead time; that of this one after
            it.
        dq, measured, ages: (n,) see `Following.tick`.
        tolerance, lag, dt: see there.
    """
    kept, kept_moves = 1.0 - dt / (dt + _FORGETTING), 1.0 - dt / (dt + _FORGETTING_MOVES)
    kept_before = 1.0 - dt / (dt + lag)
    late, moves, stands = False, False, True
    for i in range(len(dq)):
        told = dq[i] * dt
        state[_WITHIN, i] = max(state[_WITHIN, i] + abs(told) - travels[i], 0.0)
        state[_BEFORE, i] = kept_before * state[_BEFORE, i] + travels[i]
        travels[i] = abs(told)
        state[_RECENT, i] = kept_moves * state[_RECENT, i] + abs(told)
        off = measured[i] - state[_MEASURED, i]
        moved = off - min(max(off, -_NOISE), _NOISE)
        state[_MEASURED, i] += moved
        lost = kept * state[_LOST, i] + told
        done = _of_what_is_left(_GAIN * moved, lost)
        state[_LOST, i] = lost - done
        late_by = state[_WITHIN, i] + state[_BEFORE, i]
        explained = min(max(state[_OWED, i], -late_by), late_by)
        owed = explained + kept * (state[_OWED, i] - explained) + told
        state[_OWED, i] = owed - moved
        # A late arm that coasts to rest does what it owes, and is moved by nobody.
        caught_up = _of_what_is_left(moved, owed)
        beside = moved - (caught_up if abs(caught_up) > abs(done) / _GAIN else done / _GAIN)
        state[_BESIDE, i] = kept_moves * state[_BESIDE, i] + beside
        state[_AWAY, i] = kept * state[_AWAY, i] + beside
        state[_TOLD, i] += abs(told)
        state[_SHIFT, i] += told
        state[_LEAST, i] = min(state[_LEAST, i], state[_SHIFT, i])
        state[_MOST, i] = max(state[_MOST, i], state[_SHIFT, i])
        state[_DONE, i] += abs(done)
        # A joint that is told nothing loses nothing more.
        if ages[i] <= 0.0 and told * state[_LOST, i] > 0.0:
            late = late or _behind(state, i) > tolerance + late_by
        # An arm that comes to rest late coasts by no more than it was told of late.
        moves = moves or abs(state[_BESIDE, i]) > tolerance + state[_RECENT, i]
        stands = stands and late_by < _NOISE
    shifted, disorder = measured - state[_STOOD], 0.0
    if _is_elsewhere(state, shifted, 0.5 * tolerance):
        disorder = _disorder(state[_SHIFT], shifted) * np.sqrt((dq * dq).sum()) * dt
    return late, moves, stands, disorder
