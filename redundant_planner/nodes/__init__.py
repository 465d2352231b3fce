"""The ROS nodes: they convert, check ages, call the core and publish."""

import os
import signal
import sys

# While the modules of a node's own process load there is nothing to say goodbye to: Ctrl-C then
# ends it as SIGTERM does, without a traceback. `process.run` takes over from here.
_PROGRAMS = ('-m', 'planner_node', 'fake_hardware_node', 'scenario_player')
if (os.path.basename(sys.argv[0]) in _PROGRAMS
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler):
    signal.signal(signal.SIGINT, signal.SIG_DFL)
