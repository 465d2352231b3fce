"""One problem with all methods, in a process that has prepared the arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
import gc
from pathlib import Path
from typing import NamedTuple

from benchmark.peers import MissingPeerError, PEERS
from benchmark.problem_sets.generated import generate
from benchmark.problem_sets.judgement import collided, Judge, Outcome
from benchmark.problem_sets.moveit_files import ProblemFileError, read_problem
from benchmark.problem_sets.problem import fault_of, Problem, settled
from benchmark.problem_sets.servo import (
    LONGEST,
    peer_step,
    planner_step,
    servo,
    Step,
    there_and_back,
)
from benchmark.robots import make_robot
from benchmark.scenarios import METHODS as SCENARIO_METHODS, UNFILTERED
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.resources import panda_urdf

# What is commanded depends on where the arm is, so nothing is known ahead.
METHODS = {'variational': SCENARIO_METHODS['variational_held'], **{
    name: parameters for name, parameters in SCENARIO_METHODS.items()
    if not name.startswith('variational')}}
# RoboPlan's planner: it is no method that goes tick by tick.
ROBOPLAN_RRT = 'roboplan_rrt'
__all__ = ['METHODS', 'PEERS', 'ROBOPLAN_RRT', 'Job', 'Result', 'Task', 'Worker', 'prepare',
           'run_job']

# Family, scene and request; or seed, family and number.
Job = tuple[str, Path, Path] | tuple[int, str, int]


class Task(NamedTuple):
    """What to do with every problem.

    Attributes:
        methods: names.
        margin: that everybody keeps from obstacles [m].
        explain: whether to look into what was not reached.
        to_target: whether this package's methods get the goal as a target.
        optimum: whether to look for the shortest joint path from each way found.
        fastest: whether to look how fast each way can be followed.
        again: whether this package's methods have gone there and back before.
        longest: run [s].
    """

    methods: tuple[str, ...]
    margin: float
    explain: bool = False
    to_target: bool = False
    optimum: bool = False
    fastest: bool = False
    again: bool = False
    longest: float = LONGEST


@dataclass(frozen=True)
class Result:
    """What became of a problem.

    Attributes:
        fault: why it was left out; empty if it was not.
        outcomes: method → what it came to.
        free_way: whether a way that gives up the line reaches the goal; None if nobody looked.
        line_blocked: whether the line takes the hand into an obstacle; likewise.
    """

    fault: str = ''
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    free_way: bool | None = None
    line_blocked: bool | None = None


class Worker:
    """The Panda and its judge."""

    def __init__(self, task: Task) -> None:
        """Prepare."""
        urdf = panda_urdf()
        if urdf is None:
            raise SystemExit('no Panda URDF: pip install example-robot-data')
        self.task, self.robot = task, make_robot('panda', 6)
        self.judge = Judge(self.robot, urdf)
        gc.collect()
        gc.freeze()  # as the node does

    def problem(self, job: Job) -> Problem:
        """Read a problem, or make it.

        Raises:
            ProblemFileError: as `read_problem`.
        """
        first, second, third = job
        if isinstance(first, int):
            assert isinstance(second, str) and isinstance(third, int)
            return generate(self.robot, first, second, third)
        assert isinstance(second, Path) and isinstance(third, Path)
        return settled(self.robot, self.judge.capsules,
                       read_problem(first, second, third, self.robot.joint_names))

    def __call__(self, job: Job) -> Result:
        """Run every method on a problem."""
        problem, task = self.problem(job), self.task
        fault = fault_of(self.robot, self.judge.capsules, problem, task.margin)
        if fault:
            return Result(fault)
        result = Result('', {name: self._outcome(name, problem) for name in task.methods})
        if not task.explain or all(o.reached for o in result.outcomes.values()):
            return result
        from benchmark.problem_sets.explanation import free_way_exists, line_blocked
        around = self.robot, self.judge.capsules, problem, task.margin
        # A run that reached the goal unharmed shows that there is a way.
        known = any(o.reached and not collided(o) for o in result.outcomes.values())
        return replace(result, free_way=known or free_way_exists(*around),
                       line_blocked=line_blocked(*around))

    def _outcome(self, name: str, problem: Problem) -> Outcome:
        """Run a method, judge it, and compare its way with the shortest."""
        task = self.task
        if name == ROBOPLAN_RRT:
            from benchmark.problem_sets.roboplan_rrt import planned
            run = planned(self.robot, problem, task.margin)
            outcome = self.judge.judge(problem, run)
            outcome = replace(outcome, thought=outcome.cpu)
        else:
            problem, step = _begun(self.robot, name, problem, task)
            run = servo(self.robot, problem, step, task.longest,
                        to_target=task.to_target and name in METHODS)
            outcome = self.judge.judge(problem, run)
        if task.fastest and run.reached:
            from benchmark.problem_sets.fastest import fastest_time
            outcome = replace(
                outcome, time_ratio=outcome.time / fastest_time(self.robot, run.postures))
        if task.optimum and run.reached:
            from benchmark.problem_sets.shortest import path_ratio
            outcome = replace(outcome, path_ratio=path_ratio(
                self.robot, problem, run.postures, task.margin))
        return outcome


def _begun(robot: Robot, name: str, problem: Problem, task: Task) -> tuple[Problem, Step]:
    """Return a problem as a method by name begins it, and the step of the method."""
    if name in METHODS:
        given: PlannerParameters = METHODS[name]
        kept = max(given.clearance_margin, task.margin) if task.to_target else task.margin
        parameters = replace(given, clearance_margin=kept, target_margin=task.margin)
        planner = Planner(robot, parameters, filtered=name not in UNFILTERED)
        if task.again:
            problem = there_and_back(planner, problem)
        return problem, planner_step(planner, problem, to_target=task.to_target)
    try:
        return problem, peer_step(robot, name, problem, task.margin)
    except MissingPeerError as error:
        raise ProblemFileError(str(error)) from None


worker: Callable[[Job], Result]


def prepare(task: Task) -> None:
    """Make the `worker` of a process."""
    global worker
    worker = Worker(task)


def run_job(job: Job) -> Result:
    """Run every method on a problem."""
    return worker(job)
