"""Compiles all mathematics ahead of the first start, on two cores: run it after an installation.

    python -m redundant_planner.compile

Whatever is compiled already is only loaded. Without it the first import does the same work, on one
core. Two processes compile side by side; what one of them needs from the other comes in an
earlier step.
"""

from __future__ import annotations

import contextlib
from importlib import import_module
import io
import multiprocessing
import os
import time

# Steps of two lanes each: modules that do not import each other.
STEPS = (
    (('core.redundancy.null_space', 'core.robot.se3'),
     ('core.robot.jacobian', 'core.robot.kinematics', 'core.obstacles.clearance')),
    (('core.obstacles.near_pairs', 'core.redundancy.criteria'),
     ('core.obstacles.self_collision', 'core.safety.limits', 'core.safety.qp',
      'core.safety.position_command', 'core.obstacles.motion_estimate', 'core.robot.model')),
    (('core.obstacles.courses', 'core.safety.barriers'),
     ('core.redundancy.reference', 'core.safety.pace', 'core.obstacles.nearby',
      'io.obstacle_tracker', 'io.preview_reader', 'perception.depth_camera')),
    (('core.tick',),
     ('core.horizon.path_linearised', 'core.horizon.path_qp', 'core.horizon.multi_start',
      'perception.cloud_filter')),
    (('core.planner',), ()),
)


def main() -> int:
    """Compile everything; return the process's exit status."""
    begin = time.monotonic()
    print('compiling the mathematics of redundant_planner', flush=True)
    # A fifth less work than the highest level, and the ticks are as fast.
    os.environ.setdefault('NUMBA_OPT', '2')
    # The children inherit the libraries, which take seconds to load.
    for library in ('daqp', 'numba', 'pinocchio', 'scipy.spatial'):
        import_module(library)
    forked = multiprocessing.get_context('fork')
    for lanes in STEPS:
        children = [forked.Process(target=_compile, args=(lane,)) for lane in lanes if lane]
        for child in children:
            child.start()
        for child in children:
            child.join()
        if any(child.exitcode for child in children):
            return 1
    print(f'done after {time.monotonic() - begin:.0f} s')
    return 0


def _compile(lane: tuple[str, ...]) -> None:
    """Compile modules in a process of its own; `main` has already said that it takes a while."""
    with contextlib.redirect_stderr(io.StringIO()):
        for module in lane:
            import_module(f'redundant_planner.{module}')


if __name__ == '__main__':
    raise SystemExit(main())
