"""How even this machine lets any process be: one that only waits for even moments.

    python -m benchmark.bare_loop 1000

prints the 99th percentile of its periods [ms] at this rate [Hz]. `benchmark.loop` runs it ahead of
each measurement: what a virtual machine's host takes away shows here as well.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.nodes import runtime
from redundant_planner.nodes.command_pacer import CommandPacer, wake_up_in_time

_SECONDS = 3.0


def period_p99(rate: float) -> float:
    """Return the 99th percentile of the periods of a process that only waits [ms]."""
    wake_up_in_time()
    runtime.request_priority(PlannerNodeParameters().thread_priority)
    period = 1.0 / rate
    pacer = CommandPacer(period)
    begin, sent = time.monotonic(), []
    for i in range(1, round(_SECONDS * rate) + 1):
        pacer.begin(time.monotonic())
        pacer.wait()
        sent.append(time.monotonic())
        time.sleep(max(begin + i * period - sent[-1], 0.0))
    return 1e3 * float(np.percentile(np.diff(sent), 99))


if __name__ == '__main__':
    print(period_p99(float(sys.argv[1])))
