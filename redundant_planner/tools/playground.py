"""playground: a page in the browser to see an arm, drive it and put obstacles in its way.

Starts a planner, a simulated arm and the page. With --attach it shows a planner and an arm that
run already, and drives them only with --drive.
"""

from __future__ import annotations

import argparse
import logging
import os
from pathlib import Path
import signal
import sys
import tempfile
import time
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from redundant_planner.core.errors import PlannerError

if TYPE_CHECKING:
    from rclpy.executors import Executor

# The loop's period: what browsers draw [s].
_PERIOD = 1.0 / 30.0
# How long ROS is listened to in each period at least, however long drawing takes [s].
_LISTENING = 0.005
# How long others in the ROS domain get to be discovered before our own arm starts [s].
_DISCOVERY = 1.0
_LOOPBACK = ('localhost', '127.0.0.1', '::1')


def _options(args: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='playground', description=__doc__)
    parser.add_argument('--robot', type=Path, metavar='FILE',
                        help='parameter file of the arm to start (default: a Panda)')
    parser.add_argument('--urdf', default='', help="URDF in the place of the file's")
    parser.add_argument('--attach', action='store_true',
                        help='start neither planner nor arm, show those that run')
    parser.add_argument('--drive', action='store_true',
                        help='with --attach: drive them, too')
    parser.add_argument('--planner', default='planner_node', metavar='NAME',
                        help="with --attach: name of the planner's node")
    parser.add_argument('--namespace', action='append', default=[], metavar='NAME',
                        help='with --attach: of planner and arm; again for more arms')
    parser.add_argument('--host', default='127.0.0.1',
                        help='address to listen on (default: this machine alone)')
    parser.add_argument('--port', type=int, default=8070,
                        help='of the page; the 3-D view takes the next free one')
    parser.add_argument('--recordings', type=Path, default=Path('recordings'), metavar='DIR',
                        help='folder for bags and reports')
    options = parser.parse_args(args)
    if not 0 <= options.port < 65536:
        parser.error(f'--port is {options.port}; it takes a number from 0 to 65535')
    if not options.attach:
        for flag, given in (('--drive', options.drive), ('--namespace', options.namespace),
                            ('--planner', options.planner != 'planner_node')):
            if given:
                parser.error(f'{flag} is for --attach; without it the page starts its own arm, '
                             'and drives that')
    elif options.robot or options.urdf:
        parser.error('with --attach the planner says which robot it moves: leave --robot and '
                     '--urdf away')
    return options


def main(args: list[str] | None = None) -> int:
    """Run the playground until Ctrl-C; return the process's exit status."""
    options = _options(args)
    try:
        import viser  # noqa: F401
    except ImportError:
        print("playground: the page needs viser: pip install 'viser>=1.1,<2'", file=sys.stderr)
        return 2
    # Ended politely, it stops the arm as it does after Ctrl-C.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        return _run(options)
    except (PlannerError, OSError) as error:
        print(f'playground: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('playground: ended', file=sys.stderr)
        return 0


def _run(options: argparse.Namespace) -> int:
    """Start what is needed, and run the page.

    Raises:
        PlannerError, OSError: with what is wrong.
        KeyboardInterrupt: the end.
    """
    import rclpy
    from rclpy.context import Context
    from rclpy.signals import SignalHandlerOptions

    from redundant_planner.nodes.runtime import (
        best_executor,
        keep_off_shared_memory,
        ros_domain,
        spin_once,
    )
    from redundant_planner.playground import app
    from redundant_planner.playground.scene_nodes import SceneNodes
    from redundant_planner.playground.scenes import page_scenes
    from redundant_planner.playground.viser_server import lead_to, viser_server

    domain = ros_domain()
    if not options.attach:  # a simulated arm is nobody else's business on the network
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    keep_off_shared_memory()
    context = Context()
    rclpy.init(context=context, domain_id=domain,
               signal_handler_options=SignalHandlerOptions.NO)
    logging.getLogger('websockets').setLevel(logging.CRITICAL)  # says each closed tab is an error
    nodes = None if options.attach else SceneNodes(domain, options.robot, options.urdf)
    executor = best_executor(context)
    folder = tempfile.TemporaryDirectory()
    try:
        if nodes is not None:
            _check_alone(executor, domain)
        server = viser_server(
            options.host, options.port + 1 if options.port else 0, Path(folder.name))
        page = app.Playground(
            executor, server, app.Options(
                options.planner, drives=options.drive or not options.attach,
                stops_at_release=options.attach, arms=tuple(options.namespace) or ('',),
                recordings=options.recordings.resolve()),
            page_scenes(options.robot), nodes, dict(os.environ, ROS_DOMAIN_ID=str(domain)))
        try:
            url = page.serve(options.host, options.port)
            lead_to(urlsplit(url).port or 80, Path(folder.name))
            _announce(url, options)
            while True:
                due = time.monotonic() + _PERIOD
                page.turn()
                due = max(due, time.monotonic() + _LISTENING)
                while (left := due - time.monotonic()) > 0.0:
                    spin_once(executor, left)
        finally:
            # Another Ctrl-C would leave the arm without the planner's last word.
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.SIG_IGN)
            page.close()
            server.stop()
    finally:
        if nodes is not None:
            nodes.__exit__(None, None, None)
        rclpy.try_shutdown(context=context)
        folder.cleanup()


def _announce(url: str, options: argparse.Namespace) -> None:
    """Say where the page is, and what opening it means."""
    print(f'\nplayground: open {url}\n', flush=True)
    who = 'everybody who reaches this address' if options.host not in _LOOPBACK else (
        'everybody who is logged in on this machine')
    what = 'sees the arm' if options.attach and not options.drive else (
        'sees the arm and may drive it, the first visitor alone')
    print(f'Who opens it {what}: {who}. Ctrl-C ends it.', flush=True)


def _check_alone(executor: Executor, domain: int) -> None:
    """Make sure that there is no arm in the domain yet.

    Raises:
        PlannerError: there is one.
    """
    from rclpy.node import Node

    node = Node('playground_looks_around', context=executor.context, enable_rosout=False,
                start_parameter_services=False)
    until = time.monotonic() + _DISCOVERY
    try:
        while time.monotonic() < until:
            time.sleep(0.1)
            found = {info.node_name for topic in ('joint_states', 'joint_command')
                     for info in node.get_publishers_info_by_topic(topic)}
            if found:
                raise PlannerError(
                    f'an arm or a planner runs already in ROS domain {domain}: '
                    f"{', '.join(sorted(found))}; show it with --attach, end it, or set "
                    'ROS_DOMAIN_ID to another number')
    finally:
        node.destroy_node()


if __name__ == '__main__':
    sys.exit(main())
