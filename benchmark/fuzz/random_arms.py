"""Serial arms that nobody would build: 3 to 14 joints of any kind, limits and link shapes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from benchmark.fuzz.mutations import pick
from redundant_planner.core.parameters import AXES, COMMAND_FRAMES
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

_KINDS = ('revolute', 'revolute', 'revolute', 'continuous', 'prismatic')
_AXES = np.eye(3)


def random_arm(random: np.random.Generator) -> Robot:
    """Return an arm whose links can meet, with 1 to 6 controlled axes.

    Some are as fast as they are slow to brake: much is then near to them at the same time.
    """
    n = int(random.integers(3, 15))
    parts = ['<robot name="random"><link name="link0"/>']
    for i in range(1, n + 1):
        kind = pick(random, _KINDS)
        axis = pick(random, _AXES) if random.random() < 0.7 else random.normal(size=3)
        turn = random.choice([0.0, 0.5 * np.pi, -0.5 * np.pi], 3)
        place = random.normal(size=3) * pick(random, (0.0, 0.05, 0.15))
        ends = random.uniform(0.2, 0.5 if kind == 'prismatic' else 3.1, 2)
        parts.append(
            f'<link name="link{i}"/><joint name="joint{i}" type="{kind}">'
            f'<parent link="link{i - 1}"/><child link="link{i}"/>'
            f'<origin xyz="{_written(place)}" rpy="{_written(turn)}"/>'
            f'<axis xyz="{_written(axis)}"/>'
            f'<limit lower="{-ends[0]}" upper="{ends[1]}" velocity="1" effort="1"/></joint>')
    fastest = 10.0 ** random.uniform(-1.0, 1.0) * random.uniform(0.5, 2.0, n)
    hardest = 10.0 ** random.uniform(-0.5, 1.7) * random.uniform(0.5, 2.0, n)
    jerk = pick(random, (None, np.inf, 10.0 ** random.uniform(0.5, 2.0) * hardest))
    axes = random.permutation(AXES)[:random.integers(1, min(n, 6) + 1)]
    return Robot(
        ''.join((*parts, '</robot>')), f'link{n}', axes=[str(axis) for axis in axes],
        command_frame=pick(random, COMMAND_FRAMES), velocity_max=fastest,
        acceleration_max=hardest, jerk_max=jerk, capsules=_shapes(random, n))


def _shapes(random: np.random.Generator, n: int) -> list[Capsule]:
    """Return up to three capsules for every link, of lengths that reach its neighbours."""
    return [Capsule(f'link{i}', f'link{i}', 0.1 * random.normal(size=3),
                    0.1 * random.normal(size=3), float(random.uniform(0.0, 0.06)))
            for i in range(1, n + 1) for _ in range(int(random.integers(0, 4)))]


def _written(numbers: Array) -> str:
    return ' '.join(f'{number:.9g}' for number in numbers)
