"""Follow a policy that sends chunks of joint positions: each replaces the rest of the last one."""

import numpy as np

from redundant_planner import Chunk, Obstacle, Planner, PlannerParameters, Robot, Scene

robot = Robot.from_file('package://redundant_planner/config/robots/paper_2p5r.yaml')
planner = Planner(robot, PlannerParameters())
scene = Scene.of([Obstacle('ball', center=[0.0, 0.55, 0.45], semi_axes=[0.05, 0.03, 0.03])])
home = np.array([0.1, 0.1, 0.0, 0.52, -0.52, 1.05, 0.0])  # [m, rad]
random = np.random.default_rng(0)
dt, still = 0.004, np.zeros(6)


def policy(now: float) -> Chunk:
    """Return 16 points at 20 Hz from now on, a little beside those of the last call."""
    times = np.arange(16) / 20.0
    swing = 0.1 * (1.0 - np.cos(now + times))
    return Chunk(times, home + np.outer(swing, np.ones(7)) + random.normal(0.0, 0.005, 7))


q, before, hardest = home, np.zeros(7), 0.0
for tick in range(2000):
    now = dt * tick
    if tick % 100 == 0:  # every 0.4 s, half of a chunk
        chunk = policy(now)
    # The same object in each tick; `late` says how long ago a chunk began that comes late.
    result = planner.step(q, still, scene, dt, target=chunk)
    q = q + dt * result.dq
    hardest = max(hardest, float((np.abs(result.dq - before) / dt / robot.acceleration_max).max()))
    before = result.dq
    if tick % 250 == 0:
        progress = result.progress
        print(f'{now:.1f} s: {progress.state.value}, {1e3 * progress.beside:4.1f} mrad beside the '
              f'chunk, {progress.behind:.2f} s behind it {result.reason}')
print(f'largest acceleration: {hardest:.2f} of the limit')
