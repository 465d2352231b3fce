"""Compiles all mathematics ahead of the first start, on two cores: run it after an installation.

    python -m redundant_planner.compile

Whatever is compiled already is only loaded. Without it the first import does the same work, on one
core. Two processes compile side by side; what one of them needs from the other comes in an
earlier step. Both live on from step to step, for Numba compiles NumPy's functions once in each
process.
"""

from __future__ import annotations

import gc
from importlib import import_module
import multiprocessing
from multiprocessing import connection
from multiprocessing.synchronize import Barrier
import os
import sys
import time

from redundant_planner.core.machine_code.progress import bar, functions_to_compile

# Steps of two lanes each: modules that do not import each other.
STEPS = (
    (('core.robot.se3', 'core.robot.cone'), ('core.robot.kinematics', 'core.safety.limits')),
    (('core.obstacles.clearance',), ('core.obstacles.self_collision',)),
    (('core.obstacles.near_pairs',),
     ('core.redundancy.null_space', 'core.redundancy.criteria', 'core.redundancy.reference')),
    (('core.safety.barriers', 'core.safety.self_motion', 'core.safety.singularity_row'),
     ('core.safety.pace', 'core.obstacles.nearby', 'core.safety.qp',
      'core.safety.position_command', 'core.safety.following')),
    (('core.tick',), ('core.horizon.path_linearised', 'core.horizon.path_qp')),
    (('core.target.tree_growth', 'core.target.shortcuts', 'core.target.elastic_band',
      'io.obstacle_tracker'),
     ('core.horizon.multi_start',)),
    (('core.planner',),
     ('perception.cloud_filter', 'perception.depth_camera', 'perception.octree',
      'io.preview_reader')),
)


def main() -> int:
    """Compile everything; return the process's exit status."""
    begin = time.monotonic()
    print('compiling the mathematics of redundant_planner', flush=True)
    # A fifth less work than the highest level, and the ticks are as fast.
    os.environ.setdefault('NUMBA_OPT', '2')
    # The children inherit the libraries, which take seconds to load, and by which means they
    # compile.
    for library in ('daqp', 'numba', 'pinocchio', 'scipy.spatial'):
        import_module(library)
    forked = multiprocessing.get_context('fork')
    told, ready = forked.SimpleQueue(), set[str]()

    def tell(name: str, *, compiled: bool) -> None:
        told.put(name)

    import_module('redundant_planner.core.machine_code.compiling').listeners.append(tell)
    import_module('redundant_planner.core.kernels')
    total = functions_to_compile()
    both_done = forked.Barrier(2)
    working = [forked.Process(target=_compile, args=(lanes, both_done)) for lanes in zip(*STEPS)]
    for process in working:
        process.start()
    while working:
        connection.wait([process.sentinel for process in working], timeout=0.2)
        while not told.empty():
            ready.add(told.get())
        if sys.stdout.isatty():
            print(bar(len(ready), total, time.monotonic() - begin), end='   \r', flush=True)
        if any(process.exitcode for process in working):
            for process in working:
                process.terminate()
            return 1
        working = [process for process in working if process.exitcode is None]
    print(f'{len(ready)} functions are ready after {time.monotonic() - begin:.0f} s' + 20 * ' ')
    return 0


def _compile(lanes: tuple[tuple[str, ...], ...], both_done: Barrier) -> None:
    """Compile one lane of each step."""
    # Numba makes millions of objects that live on: looking through them takes a tenth of the time.
    gc.disable()
    for lane in lanes:
        for module in lane:
            import_module(f'redundant_planner.{module}')
        both_done.wait()


if __name__ == '__main__':
    raise SystemExit(main())
