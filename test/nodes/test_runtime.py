"""What surrounds a node's process: Ctrl-C while rclpy's executor runs callbacks."""

from __future__ import annotations

import os
import signal
import threading

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from ros_domains import next_domain

from redundant_planner.nodes.runtime import best_executor, spin_once


@pytest.fixture
def node():
    context = Context()
    rclpy.init(context=context, domain_id=next_domain(),
               signal_handler_options=SignalHandlerOptions.NO)
    node = Node('interrupted', context=context, enable_rosout=False,
                start_parameter_services=False)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield node
    for number, handler in before.items():
        signal.signal(number, handler)
    node.destroy_node()
    rclpy.try_shutdown(context=context)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_in_a_callback_waits_for_its_end(node, number, capfd):
    signal.signal(number, signal.default_int_handler)
    executor = best_executor(node.context)
    executor.add_node(node)
    begun, ended = [], []

    def interrupted():
        begun.append(None)
        os.kill(os.getpid(), number)
        ended.append(None)

    node.create_timer(0.001, interrupted)
    for count in range(1, 6):
        with pytest.raises(KeyboardInterrupt):
            while True:
                spin_once(executor, 0.1)
        assert len(begun) == len(ended) >= count
        assert signal.getsignal(number) is signal.default_int_handler
    assert 'Exception' not in capfd.readouterr().err


def test_ctrl_c_while_nothing_happens_counts_too(node):
    signal.signal(signal.SIGINT, signal.default_int_handler)
    executor = best_executor(node.context)
    executor.add_node(node)
    threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        while True:
            spin_once(executor, 0.5)


def test_a_signal_that_is_ignored_or_taken_otherwise_stays_so(node):
    taken = []
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: taken.append(number))
    executor = best_executor(node.context)
    executor.add_node(node)
    for number in (signal.SIGINT, signal.SIGTERM):
        threading.Timer(0.05, os.kill, (os.getpid(), number)).start()
    while not taken:
        spin_once(executor, 0.1)
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
