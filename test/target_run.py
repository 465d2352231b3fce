"""Closed loops with a target instead of a twist."""

from __future__ import annotations

from conftest import make_panda, PANDA_READY
import numpy as np

from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.progress import TargetState

DT = 0.004
STILL = np.zeros(6)
EMPTY = Scene.of(())
# Slower than this is at rest, see docs/interface.md [rad/s].
AT_REST = 2e-3
PANDA = make_panda()


def tip(robot, q):
    arm = robot.kinematics(q)
    return Pose(arm.tip_position, arm.tip_rotation)


def moved(pose, displacement):
    """A pose displaced by (6,) in base axes [m, rad]."""
    return se3.displaced(pose, np.array(displacement, dtype=float), False)


class Run:
    """A closed loop with an arm that follows at once; the planner may work ahead of ticks."""

    def __init__(self, robot=PANDA, start=PANDA_READY, *, ahead=False, **parameters):
        self.planner = Planner(robot, PlannerParameters(**parameters))
        self.planner.reset()
        self.q = np.array(start)
        self.positions, self.results, self.ahead = [self.q], [], ahead

    def to(self, target, seconds, scene=EMPTY):
        """Go to a target for as long as that or until at rest there.

        The target and the scene may be functions of the time.

        Returns the progress of the last tick.
        """
        for i in range(round(seconds / DT)):
            aim = target(i * DT) if callable(target) else target
            around = scene(i * DT) if callable(scene) else scene
            result = self.planner.step(self.q, STILL, around, DT, target=aim)
            self.q = self.q + DT * result.dq
            self.positions.append(self.q)
            self.results.append(result)
            if self.ahead:
                self.planner.prepare(around)
            if (not callable(target) and result.progress.state is TargetState.REACHED
                    and np.abs(result.dq).max() < AT_REST):
                break
        return result.progress

    def let_go(self, scene=EMPTY):
        """Command a twist of zero for a second in the target's place; return the last result."""
        for _ in range(250):
            result = self.planner.step(self.q, STILL, scene, DT)
            self.q = self.q + DT * result.dq
            self.positions.append(self.q)
        return result

    @property
    def seconds(self):
        return DT * len(self.results)

    @property
    def tips(self):
        return np.array([self.planner.robot.kinematics(q).tip_position for q in self.positions])

    def assert_within_limits(self):
        robot = self.planner.robot
        velocities = np.diff(self.positions, axis=0) / DT
        speeds = np.vstack((np.zeros((2, robot.n)), velocities))
        acceleration = np.diff(speeds, axis=0) / DT
        assert (np.abs(velocities) <= robot.velocity_max + 1e-9).all()
        assert (np.abs(acceleration) <= robot.acceleration_max * (1.0 + 1e-6)).all()
        assert (np.abs(np.diff(acceleration, axis=0)) / DT <= robot.jerk_max * (1 + 1e-6)).all()
        assert (np.array(self.positions) <= robot.position_max).all()
        assert (np.array(self.positions) >= robot.position_min).all()
