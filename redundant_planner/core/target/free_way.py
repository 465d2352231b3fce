"""To a target by a short joint path, wherever that takes the tip.

A standing arm thinks: it looks for a way to any posture with the tip at the target, a little in
each tick. The first good one is made smooth, and the joints follow it as fast as they may. The arm
goes on thinking while it moves: a better rest of the way, from a place that is far enough ahead,
takes the old one's place. Where something gets in the way, or another target comes, the arm thinks
again while it brakes, and goes on from where it would stand.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

import numpy as np
import numpy.typing as npt

from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Poses, stacked
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.target.curve_search import CurveSearch, OVERLAP
from redundant_planner.core.target.free_space import FreeSpace
from redundant_planner.core.target.goal import Goal
from redundant_planner.core.target.joint_curve import JointCurve
from redundant_planner.core.target.joint_motion import JointMotion
from redundant_planner.core.target.joint_way import JointWay
from redundant_planner.core.target.past_ways import PastWays
from redundant_planner.core.target.patience import Patience

Array = npt.NDArray[np.float64]

# What a tick works at the search at most: while the arm stands and waits for a way, and while it
# is on one [s].
_MOST_WORK, _MOST_ON_THE_WAY = 1.2e-3, 0.9e-3
# After this time any way will do, in searches for the same target after ever less: those that are
# good are alike, and the filter may stop each. Where the arm has gone before there is a way at
# once, and most others that are better are found by the second one. After the third the tip goes
# as near as a line takes it [s].
_LATE, _LATE_FOR_KNOWN, _LONGEST = 0.25, 0.06, 1.0
# After this time without a way a tick works a quarter as much [s].
_DILIGENT = 5.0
# The rest of a way that is improved begins this far ahead of the arm [s], and is at least so many
# control points long; after so many attempts in all it stays as it is.
_AHEAD, _FEWEST_POINTS, _MOST_ROUNDS = 0.15, 4, 24
# Postures of a way that is followed that are looked at, to see whether it is still free, and how
# often [s].
_LOOKS_AHEAD, _LOOK_PERIOD = 12, 0.1
# A search that has found nothing begins anew among other obstacles after this time, then after
# twice as long each, up to some [s]: what moves elsewhere must not keep it from an end.
_NEWS_PERIOD, _LONGEST_NEWS_PERIOD = 2.0, 4.0
# An arm that gives way does so after this time without a way, and stays aside for so long [s].
_PATIENT, _ASIDE = 3.0, 8.0
# An arm this near to where it comes to rest stands [rad, m].
_STANDS = 1e-3
# What a way that is followed may be inside the margin before it counts as blocked [m].
_INSIDE = 2e-3
# The arm thinks again if it is this far from its way, or pushed so far while it thinks [rad, m].
_STRAYED, _PUSHED = 0.1, 0.02
# A target that moves by more is another one [m, rad], and one this near is gone to in a line.
_ANOTHER, _NEAR, _NEAR_ANGLE = 1e-3, 0.02, 0.1
# Deadband of the feedback at the end [rad, m].
_AT_REST = 1e-5
# Largest speed of the feedback to the way [rad/s, m/s].
_FEEDBACK_SPEED = 0.2


class Stretch(Enum):
    """What a free way is up to."""

    THINKING = 'thinking'
    FOLLOWING = 'following'
    LINE = 'line'  # the rest, or what is near, is gone to in a line


class FreeWay:
    """The free way of one arm to its target.

    Attributes:
        stretch: what it is up to.
        out_of_reach: whether no posture has the tip at the target, as far as it knows.
        tried_line: whether it has found no way, and let the tip go as near as a line takes it.
    """

    def __init__(
        self, robot: Robot, limits: Limits, scaling: Array, full_speed: Array, gain: float, *,
        effort: float, gives_way: bool,
    ) -> None:
        """Prepare for an arm.

        Args:
            robot: the arm.
            limits: of its joints.
            scaling: (n,) see `PathJoints`.
            full_speed: highest linear and angular speed of the tip [m/s, rad/s].
            gain: of the feedback to the way [1/s].
            effort: share of a tick's time that it may think.
            gives_way: whether it steps aside for others where it has no way.
        """
        self._robot, self._limits, self._scaling = robot, limits, scaling
        self._full_speed, self._gain, self._gives_way = full_speed, gain, gives_way
        self._effort, self._past = effort, PastWays()
        self._way: JointWay | None = None
        self.reset()

    def go_on_from(self, before: FreeWay) -> None:
        """Remember the ways that another one remembers, that which it is on among them."""
        before._note_way()
        self._past = before._past

    def forget_past(self) -> None:
        """Forget the ways that the arm has gone."""
        self._past = PastWays()

    def reset(self) -> None:
        """Forget the target and the way; it is remembered as one that the arm has gone."""
        self._note_way()
        self.stretch, self.out_of_reach = Stretch.LINE, False
        self._target: Goal | Poses | None = None
        self._way = None
        self._finder: CurveSearch | None = None
        self._put_off: Callable[[], None] | None = None  # see `catch_up`
        self._points = np.empty((0, self._robot.n))  # control points of the way
        self._since = 0  # the first of them that the finder knows as its curve's
        self._rest: int | None = None  # the first of those that shall become better
        self._improves = False
        self._space: FreeSpace | None = None
        self._age = 0.0  # of the thought [s]
        # For this target so far, the seed of the next one: the last way may have been stopped.
        self._searches = 0
        self.tried_line = False
        self._aside: float | None = None  # for how long it has been aside [s]
        self._look_age = 0.0
        self._off = 0.0  # the joint that is furthest from where it should be [rad, m]
        self._patience = Patience()

    @property
    def seconds(self) -> float:
        """Time until its end, as far as it is known [s]."""
        return self._way.seconds if self._way is not None else 0.0

    def motion(
        self, start: Start, target: Goal | Poses, space: Callable[[], FreeSpace], *, stuck: bool,
    ) -> JointMotion | None:
        """Return what the joints shall do; None where the tip shall go on in a line.

        Args:
            start: of the tick.
            target: where it ends; of the joints, it leads there to the last bit.
            space: returns where the arm may be now, the same object while nothing changes.
            stuck: whether the tip is stuck on the line.
        """
        self.catch_up()
        if self._is_another(target):
            self.reset()
            self._target = target
            if not self._is_near(start):
                self._think(start, space())
        elif self._must_think(start, space, stuck):
            self._think(start, space())
        elif self.stretch is Stretch.THINKING:
            self._go_on_thinking(start, space)
        elif self._way is not None and self._way.over:
            self._arrive(start, space)
        elif self._improves:
            self._improve(start, space)
        if self.stretch is Stretch.LINE or self._way is None:
            return None
        here, velocity = self._way.velocity(start.dt)
        off = here - start.arm.q
        self._off = float(np.abs(off).max(initial=0.0))
        if self._way.over and self._off < _AT_REST:
            off = np.zeros_like(off)
        back = self._gain * off
        return JointMotion(velocity, np.clip(back, -_FEEDBACK_SPEED, _FEEDBACK_SPEED))

    def catch_up(self) -> bool:
        """Do what the last tick has put off, as its command does not depend on it.

        Nothing depends on when it is done, as long as that is before anything else.

        Returns:
            Whether there was something to do.
        """
        if self._put_off is None:
            return False
        self._put_off()  # where it raises, the next tick tries it again, and fails
        self._put_off = None
        return True

    def _arrive(self, start: Start, space: Callable[[], FreeSpace]) -> None:
        """Do what is next where a way ends."""
        if self._aside is not None:
            self._aside += start.dt
            if self._aside > _ASIDE:
                self._think(start, space())
        elif self._may_go_straight and (
                not _AT_REST <= self._off < _STANDS or self._patience.is_over):
            # The last bit is the joints': where one is at its limit, the tip would not get there.
            self.stretch = Stretch.LINE

    def went_on(self, followed: float, residual: float, dt: float) -> None:
        """Note which share of the tick's motion was followed, and of the last one's remained."""
        if self._way is None:
            return
        self._way.went_on(followed, residual, dt)
        self._patience.note(self._way.left, dt)

    @property
    def _may_go_straight(self) -> bool:
        """Whether tips shall be somewhere, which lines may lead to."""
        return isinstance(self._target, tuple)

    def _is_another(self, target: Goal | Poses) -> bool:
        known = self._target
        if isinstance(target, tuple) and isinstance(known, tuple):
            return not se3.same_poses(target, known) and float(np.abs(
                se3.poses_error(stacked(target), stacked(known), False)).max()) > _ANOTHER
        return (known is None or isinstance(target, tuple) or isinstance(known, tuple)
                or not np.array_equal(target, known))

    def _is_near(self, start: Start) -> bool:
        if not isinstance(self._target, tuple):
            return False
        away = self._robot.full_twist(self._robot.task_rows(se3.poses_error(
            stacked(self._target), start.reference, self._robot.in_tool))).reshape(-1, 6)
        return all(bool(np.linalg.norm(off[:3]) < _NEAR and np.linalg.norm(off[3:]) < _NEAR_ANGLE)
                   for off in away)

    def _strayed(self, start: Start) -> float:
        """Return how far any joint is from where it should be [rad, m]."""
        assert self._way is not None
        return float(np.abs(self._way.posture - start.arm.q).max())

    def _must_think(
        self, start: Start, space: Callable[[], FreeSpace], stuck: bool,
    ) -> bool:
        """Return whether it cannot go on as it does: stuck, pushed aside, or blocked ahead."""
        if self.stretch is Stretch.LINE or self._way is None:
            return stuck and not self.out_of_reach
        if self.stretch is Stretch.THINKING:
            return self._strayed(start) > _PUSHED
        if self._strayed(start) > _STRAYED or (self._patience.is_over and not self._way.over):
            return True
        self._look_age += start.dt
        if self._look_age < _LOOK_PERIOD or space() is self._space:
            return False
        self._look_age, self._space = 0.0, space()
        return self._space.nearest_obstacle(self._way.ahead(_LOOKS_AHEAD)) < -_INSIDE

    def _think(self, start: Start, space: FreeSpace) -> None:
        """Begin to look for a way from where the arm comes to rest."""
        self._note_way()
        assert self._target is not None
        stop = float(np.abs(start.previous / self._limits.acceleration_max).max())
        rest = np.clip(start.arm.q + 0.5 * stop * start.previous,
                       self._limits.positions[1], self._limits.positions[0])
        self._follow(np.linspace(start.arm.q, rest, _FEWEST_POINTS + 1), start.previous)
        self.stretch, self._age, self._stop = Stretch.THINKING, 0.0, rest
        self._aside, self._improves = None, False
        self._until_news = _NEWS_PERIOD
        self._put_off_search(space)

    def _put_off_search(self, space: FreeSpace) -> None:
        """Put off the beginning of a search; until then `_finder` is the one before."""
        assert self._target is not None
        self._space, self._look_age = space, 0.0
        stop, target, seed = self._stop, self._target, self._searches
        # Where the arm was stopped, something that nobody sees may be in the way of a known one.
        past = self._past if seed == 0 else None
        self._searches += 1

        def begin() -> None:
            self._finder = CurveSearch(
                space, stop, target, self._scaling, gives_way=self._gives_way, seed=seed,
                past=past)

        self._put_off = begin

    def _put_off_thinking(self, finder: CurveSearch, dt: float, *, any_way: bool = False) -> None:
        """Put off what a tick may think."""
        work = self._work(dt)

        def think() -> None:
            finder.think(work, any_way=any_way)
            self.out_of_reach = finder.search.goals.out_of_reach

        self._put_off = think

    def _work(self, dt: float) -> int:
        """How much a tick may think [ns]."""
        most = _MOST_WORK if self.stretch is Stretch.THINKING else _MOST_ON_THE_WAY
        work = 1e9 * min(self._effort * dt, most)
        return int(work if self._age < _DILIGENT else 0.25 * work)

    def _go_on_thinking(self, start: Start, space: Callable[[], FreeSpace]) -> None:
        """Look for a way a little further; follow it when it has been found."""
        finder = self._finder
        assert finder is not None and self._way is not None
        search = finder.search
        self._age += start.dt
        self._look_age += start.dt
        if self._may_go_straight and not self.tried_line and search.way is None and (
                self._age >= _LONGEST or self.out_of_reach):
            # As near as it gets. To find a line is work enough for a tick.
            self.stretch, self.tried_line = Stretch.LINE, True
            return
        if self._look_age > self._until_news and search.way is None and (
                space() is not finder.space):
            self._put_off_search(space())
            self._until_news = min(2.0 * self._until_news, _LONGEST_NEWS_PERIOD)
            return
        polygon = finder.found
        if polygon is None:
            late = _LATE_FOR_KNOWN if search.went_before else _LATE
            self._put_off_thinking(finder, start.dt, any_way=self._age >= late / self._searches)
        else:
            if self._is_blocked(polygon, space()):
                self._think(start, space())
                return
            self._since = 0
            if np.abs(self._way.posture - polygon[0]).max() > _STANDS:
                polygon, self._since = np.vstack((self._way.posture, polygon)), 1
            self._follow(polygon, start.previous)
            self.stretch, self.tried_line = Stretch.FOLLOWING, search.aside
            self._aside = 0.0 if search.aside else None
            self._improves, self._rest = not (search.aside or search.straight), None
            self._ahead = _AHEAD
            return
        if self._gives_way and self._age >= _PATIENT and search.way is None:
            search.step_aside()

    def _improve(self, start: Start, space: Callable[[], FreeSpace]) -> None:
        """Look for a better rest of the way a little further; follow it when it has been found."""
        finder, way = self._finder, self._way
        assert finder is not None and way is not None
        self._age += start.dt
        if self._rest is None:
            first = int(way.parameter_in(self._ahead)) + 2 + OVERLAP
            first = max(first, self._since + OVERLAP)
            last = len(self._points) - 1
            self._improves = last - first >= _FEWEST_POINTS
            if self._improves:
                finder.improve(self._points[first - OVERLAP:first + 1],
                               (first - self._since) / (last - self._since))
                self._rest = first
        elif way.parameter > self._rest - OVERLAP:
            self._rest = None  # too late for this one
        elif finder.found is None:
            self._improves = finder.search.rounds < _MOST_ROUNDS
            if self._improves:
                self._put_off_thinking(finder, start.dt)
        else:
            points, self._since = np.vstack((self._points[:self._rest], finder.found)), self._rest
            better = JointWay(
                self._robot, self._limits, self._full_speed, JointCurve(points), start.previous,
                way.parameter)
            self._rest = None
            if self._is_blocked(finder.found, space()):
                self._improves = False
            elif better.too_fast:
                self._ahead *= 2.0
            else:
                self._way, self._points = better, points

    def _is_blocked(self, points: Array, now: FreeSpace) -> bool:
        """Return whether control points (k, n) that have been found are no longer free."""
        assert self._finder is not None
        looked_at = points[::max(len(points) // _LOOKS_AHEAD, 1)]
        return now is not self._finder.space and now.nearest_obstacle(looked_at) < -_INSIDE

    def _note_way(self) -> None:
        """Remember what the arm has gone of the way that it leaves now."""
        if self._way is not None and self.stretch is not Stretch.THINKING and self._aside is None:
            self._past.note(self._way.gone)

    @property
    def in_vain(self) -> bool:
        """Whether it has looked for a way for as long as it may, and found none."""
        return (self.stretch is Stretch.THINKING and self._age >= _LONGEST
                and self._finder is not None and self._finder.search.way is None)

    @property
    def lacks(self) -> str:
        """Why it stands still or goes as near as a line takes it; empty where neither is so."""
        if self._aside is not None:
            return 'it makes way for others'
        if self._finder is None or not (self.tried_line or self.in_vain):
            return ''
        return self._finder.search.lacks

    def _follow(self, points: Array, velocity: Array) -> None:
        """Take a way's control points (k, n)."""
        self._points = points
        self._way = JointWay(
            self._robot, self._limits, self._full_speed, JointCurve(points), velocity)
        self._patience, self._look_age = Patience(), 0.0
