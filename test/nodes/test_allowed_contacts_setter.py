"""What a planner may touch, kept as the scene has it, while planners come and go; no node."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.task import Future

from redundant_planner.nodes import allowed_contacts_setter
from redundant_planner.nodes.allowed_contacts_setter import AllowedContactsSetter

WANTED = ('hand:cup', 'link7:shelf')


class Planner:
    """Its services, and a clock; it may be there or not, and refuse."""

    def __init__(self, monkeypatch):
        self.entries, self.is_there, self.refuses, self.now = [], True, False, 100.0
        self.asked, self.said = [], []
        monkeypatch.setattr(allowed_contacts_setter, 'time',
                            SimpleNamespace(monotonic=lambda: self.now))
        self.setter = AllowedContactsSetter(
            SimpleNamespace(create_client=self.client, guard=SimpleNamespace(
                call=lambda what, function, *arguments: function(*arguments))),
            'planner_node', self.said.append)

    def client(self, kind, name):
        return SimpleNamespace(
            service_is_ready=lambda: self.is_there,
            call_async=self.get if kind is GetParameters else self.set)

    def get(self, request):
        self.asked.append('get')
        value = Parameter('', Parameter.Type.STRING_ARRAY, self.entries).get_parameter_value()
        return done(GetParameters.Response(values=[value]))

    def set(self, request):
        self.asked.append('set')
        if not self.refuses:
            self.entries = list(parameter_value_to_python(request.parameters[0].value))
        return done(SetParameters.Response(results=[
            SetParametersResult(successful=not self.refuses, reason='no')]))

    def look(self, seconds=1.0, wanted=WANTED):
        """Have time pass, with a look in each second."""
        for _ in range(round(seconds)):
            self.now += 1.0
            self.setter.update(wanted)


def done(response):
    future = Future()
    future.set_result(response)
    return future


@pytest.fixture
def planner(monkeypatch):
    return Planner(monkeypatch)


def test_a_planner_that_starts_anew_between_two_looks_gets_its_contacts(planner):
    """As one does that is killed and started again: its services seem to be there all the time."""
    planner.look(3)
    assert planner.entries == list(WANTED)
    planner.entries = []
    planner.look(10)
    assert planner.entries == list(WANTED)


def test_it_is_not_asked_in_every_look(planner):
    planner.look(60)
    assert planner.asked.count('set') == 1 and planner.asked.count('get') <= 15


def test_what_is_refused_is_set_again_in_another_planner_only(planner):
    planner.refuses = True
    planner.look(30)
    assert planner.asked.count('set') == 1
    assert planner.said == ["allowed_contacts of 'planner_node' stay as they were: no"]
    planner.refuses, planner.entries = False, ['link1:box']
    planner.look(10)
    assert planner.entries == list(WANTED)
