"""Compiles all mathematics ahead of the first start, on two cores: run it after an installation.

    python -m redundant_planner.compile

Whatever is compiled already is only loaded. Without it the first import does the same work, on one
core. Two processes compile side by side; what one of them needs from the other comes in an
earlier step.
"""

from __future__ import annotations

import subprocess
import sys
import time

# Steps of two lanes each: modules that do not import each other.
STEPS = (
    (('core.redundancy.null_space', 'core.robot.se3'),
     ('core.robot.jacobian', 'core.robot.kinematics', 'core.obstacles.clearance')),
    (('core.obstacles.near_pairs', 'core.redundancy.criteria'),
     ('core.obstacles.self_collision', 'core.safety.limits', 'core.safety.qp',
      'core.safety.stopping', 'core.obstacles.motion_estimate', 'core.robot.model')),
    (('core.obstacles.evasion', 'core.safety.barriers'),
     ('core.redundancy.reference', 'core.safety.pace', 'core.obstacles.nearby',
      'io.obstacle_tracker', 'io.preview_reader')),
    (('core.tick',), ('core.horizon.path_qp',)),
    (('core.planner',), ()),
)


def main() -> int:
    """Compile everything; return the process's exit status."""
    begin = time.monotonic()
    print('compiling the mathematics of redundant_planner', flush=True)
    for lanes in STEPS:
        children = [subprocess.Popen(
            [sys.executable, '-c', '\n'.join(f'import redundant_planner.{name}' for name in lane)],
            stderr=subprocess.PIPE, text=True) for lane in lanes if lane]
        for child in children:
            _, errors = child.communicate()
            if child.returncode:
                print(errors, file=sys.stderr, end='')
                return child.returncode
    print(f'done after {time.monotonic() - begin:.0f} s')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
