"""The ROS nodes: they convert, check ages, call the core and publish."""

import os
import signal
import sys

# While its modules load, a node's process has nothing to stop: Ctrl-C ends it as SIGTERM does,
# without a traceback. `runtime.run` takes the signal over afterwards.
_PROGRAMS = ('-m', 'planner_node', 'fake_hardware_node', 'scenario_player')
if (os.path.basename(sys.argv[0]) in _PROGRAMS
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler):
    signal.signal(signal.SIGINT, signal.SIG_DFL)
