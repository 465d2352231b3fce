"""Who takes the messages of each topic that moves the arm."""

from __future__ import annotations

from types import SimpleNamespace

from conftest import make_panda, PANDA_READY
import pytest

from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.nodes import inboxes
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.paper.method import PaperPlanner

PANDA = make_panda()
TARGETS = {'target_joints', 'target_trajectory', 'target_pose', 'target_path'}


@pytest.fixture
def takers(monkeypatch):
    """Return who takes the messages of each topic for a planner, and what is said."""
    monkeypatch.setattr(inboxes, 'PolledSubscription',
                        lambda node, kind, topic, *qos: SimpleNamespace(topic=topic))

    def make(planner):
        said = []
        command = CommandInput({}, 'base', lambda: 0.0, lambda: 0.0, said.append)
        loop = SimpleNamespace(
            command=command, planner=planner, supervisor=SimpleNamespace(posture=PANDA_READY),
            joints=SimpleNamespace(on_joint_states=None, on_odometry=None))
        found = inboxes.inboxes_of(None, loop, said.append, on_base=False, stamped=False)
        return {inbox.topic: take for inbox, take in found}, said

    return make


@pytest.mark.parametrize('topic', sorted(TARGETS))
def test_a_method_that_follows_twists_only_takes_no_target(takers, topic):
    take, said = takers(PaperPlanner(PANDA, PlannerParameters(method='paper')))
    take[topic](b'')
    assert said == [f"{topic} ignored: method 'paper' follows twists only"]


@pytest.mark.parametrize('topic', sorted(TARGETS))
def test_targets_are_read_where_the_method_follows_them(takers, topic):
    take, said = takers(Planner(PANDA))
    take[topic](b'')
    assert len(said) == 1 and said[0].startswith(f'{topic} ignored: ')
    assert 'follows twists' not in said[0]
