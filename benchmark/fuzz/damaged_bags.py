"""What may be wrong with the messages of a bag: a sound one, and ways to damage it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
import struct
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Twist
import numpy as np
import numpy.typing as npt
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker

from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.parameter_files import read_robot_parameters
from redundant_planner.io.parameter_writer import parameter_file_text
from redundant_planner.io.recorded_tick import RecordedTick, TickKind
from redundant_planner.io.resources import share_directory
from redundant_planner.io.robot_files import load_robot
from redundant_planner.io.scenario import load_scenario
from redundant_planner.nodes.messages import markers_of
from redundant_planner.simulation import simulate

Random = np.random.Generator

_DT = 0.004
_ORIGIN = 1_700_000_000 * 10**9
_STATE = 'sensor_msgs/msg/JointState'
_TEXT = 'std_msgs/msg/String'
KINDS = {
    '/joint_states': _STATE, '/joint_command': _STATE, '/cmd_vel': 'geometry_msgs/msg/Twist',
    '/obstacles': 'visualization_msgs/msg/MarkerArray',
    '/attached': 'visualization_msgs/msg/MarkerArray', '/robot_description': _TEXT,
    '/planner_node/configuration': _TEXT,
    '/planner_node/ticks': 'std_msgs/msg/Float64MultiArray',
    '/cmd_vel_preview': 'trajectory_msgs/msg/MultiDOFJointTrajectory',
    '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray'}
# What numbers in a bag may be replaced by.
_NUMBERS = (0.0, -0.0, 1e-300, 1.0, -1.0, 1e5, -1e5, 1e6, 1e9, 1e150, 1e300, 1e308, -1e308,
            float('inf'), float('-inf'), float('nan'), 2.0**31, 2.0**53, 2.0**63)
_NAMES = ('</script><script>alert(1)</script>', '<!--<script>', '[/]', '[red]x', '$x^{$', 'theta4',
          '', '\x1b[2J', '__DATA__', '__BODY__', '\u2028', "';alert(1)//", 'a' * 5000, '%{x}',
          '<b>b</b>', '😀', '\x00', '../../x', 'a\nb', '_hidden')
_YAML = ('a: &a [x, x]\n' + ''.join(
    f'{chr(98 + i)}: &{chr(98 + i)} [{", ".join(["*" + chr(97 + i)] * 9)}]\n' for i in range(20)),
    '[' * 2000, '&a [*a]', '2020-13-45', '{', '\t', '- 1', '!!python/object:os.system {}',
    '/**: {ros__parameters: []}', '/**: {ros__parameters: {1: 2}}', '/**: {ros__parameters: 3}',
    '? [a, b]\n: c', '9' * 6000, '/**: {ros__parameters: {rate: 0}}', '/**:', 'null', '\ud800')


class Recorded(NamedTuple):
    """A message of a bag: topic, time of recording [ns], and bytes."""

    topic: str
    time: int
    raw: bytes


@cache
def sound() -> tuple[list[Recorded], str]:
    """Return the messages of half a second of the paper's motion, and its configuration."""
    share = share_directory() / 'config'
    scenario = load_scenario(share / 'scenarios' / 'paper.yaml')
    file = share / 'robots' / 'paper_2p5r.yaml'
    robot, parameters = load_robot(file), PlannerParameters()
    motion = simulate(Planner(robot, parameters), scenario.start_posture(robot),
                      scenario.twist_at, Scene.of(scenario.obstacles), 0.5, _DT)
    configuration = parameter_file_text(
        read_robot_parameters(file)[0], robot,
        {'post': {'center': [2.0, 0.0, 0.0], 'semi_axes': [0.1, 0.1, 0.1]}}, parameters,
        PlannerNodeParameters())
    preview = MultiDOFJointTrajectory()
    for i in range(3):
        point = MultiDOFJointTrajectoryPoint(velocities=[Twist()])
        point.time_from_start.sec = i
        preview.points.append(point)
    found = [
        Recorded('/robot_description', _ORIGIN, serialize_message(String(data=robot.urdf))),
        Recorded('/planner_node/configuration', _ORIGIN,
                 serialize_message(String(data=configuration))),
        Recorded('/cmd_vel_preview', _ORIGIN, serialize_message(preview))]
    names = list(robot.joint_names)
    for i, dq in enumerate(motion.velocities):
        at, q = _ORIGIN + round(motion.times[i] * 1e9), motion.positions[i]
        twist = np.asarray(scenario.twist_at(motion.times[i]))
        state = JointState(name=names, position=q.tolist(), velocity=dq.tolist())
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(at, 10**9)
        cmd = Twist()
        cmd.linear.x, cmd.linear.y, cmd.linear.z = twist[:3].tolist()
        cmd.angular.x, cmd.angular.y, cmd.angular.z = twist[3:].tolist()
        tick = RecordedTick(at, float(motion.times[i]),
                            TickKind.GOING_ON if i else TickKind.STARTING, 1, 1, float('nan'),
                            i // 50, twist, q)
        if i % 50 == 25:  # taken up and put down again
            held = markers_of(scenario.obstacles if i % 100 == 25 else [], robot.tip_frame)
            held.markers.insert(0, Marker(action=Marker.DELETEALL))
            found.append(Recorded('/attached', at, serialize_message(held)))
        if i % 25 == 0:
            found += [
                Recorded('/obstacles', at, serialize_message(
                    markers_of(scenario.obstacles, robot.base_frame))),
                Recorded('/diagnostics', at, serialize_message(DiagnosticArray(status=[
                    DiagnosticStatus(values=[KeyValue(key='factor k', value='0.5')])])))]
        found += [Recorded('/joint_states', at, serialize_message(state)),
                  Recorded('/cmd_vel', at, serialize_message(cmd)),
                  Recorded('/planner_node/ticks', at,
                           serialize_message(Float64MultiArray(data=tick.numbers()))),
                  Recorded('/joint_command', at, serialize_message(state))]
    return found, configuration


def damaged(random: Random, data: bytes) -> bytes:
    """Return a file with something wrong in its bytes."""
    block = bytearray(data)
    if not block:
        return bytes(block)
    at = int(random.integers(len(block)))
    length = int(random.choice([1, 8, 100, 5000]))
    what = random.integers(9)
    if what == 0:
        for place in random.integers(len(block), size=int(random.choice([1, 3, 30, 300]))):
            block[place] ^= 1 << int(random.integers(8))
    elif what == 1:
        del block[at:]
    elif what == 2:
        block[at:at + length] = bytes(len(block[at:at + length]))
    elif what == 3:
        block[at:at + length] = random.bytes(len(block[at:at + length]))
    elif what == 4:
        del block[at:at + length]
    elif what == 5:
        block[at:at] = block[:length]
    elif what == 6:
        number = int(random.choice([0, 1, 2**31, 2**32 - 1, 2**62]))
        block[at:at + 8] = struct.pack('<Q', number)[:len(block[at:at + 8])]
    elif what == 7:
        block[-min(at, 2000):] = b''
    elif what == 8 and random.random() < 0.2:
        block = bytearray(block[:int(random.integers(0, 60))])
    return bytes(block)


def _number(random: Random, message: Recorded) -> Recorded:
    """Replace one aligned number of eight bytes, or of four."""
    raw = bytearray(message.raw)
    if len(raw) < 16:
        return message
    if random.random() < 0.6:
        at = 4 + 8 * int(random.integers((len(raw) - 4) // 8))
        raw[at:at + 8] = struct.pack('<d', random.choice(_NUMBERS))
    else:
        at = 4 * int(random.integers(len(raw) // 4))
        raw[at:at + 4] = struct.pack('<I', int(random.choice(
            [0, 1, 2, 100, 2**16, 2**31 - 1, 2**31, 2**32 - 1])))
    return message._replace(raw=bytes(raw))


def _some(
    change: Callable[[Random, Recorded], Recorded], random: Random, messages: list[Recorded],
    kinds: dict[str, str],
) -> list[Recorded]:
    """Change some messages of one topic, or of all."""
    topic = str(random.choice(['', *KINDS]))
    share = random.choice([0.02, 0.3, 1.0])
    return [change(random, m) if m.topic.startswith(topic) and random.random() < share else m
            for m in messages]


def _times(random: Random, messages: list[Recorded], kinds: dict[str, str]) -> list[Recorded]:
    """Let time pause, jump, stop or go backwards."""
    at = int(random.integers(len(messages))) if messages else 0
    jump = int(random.choice([
        2 * 10**9, 3600 * 10**9, 10 * 365 * 86400 * 10**9, -10**9, -_ORIGIN, 2**62, 2**63]))
    what = random.integers(4)
    if what == 0:
        return [m._replace(time=max(m.time + jump, 0)) if i >= at else m
                for i, m in enumerate(messages)]
    if what == 1:
        return [m._replace(time=max(m.time + jump, 0)) if i == at else m
                for i, m in enumerate(messages)]
    if what == 2:
        stretch = int(random.choice([0, 2, 50, 500]))
        return [m._replace(time=_ORIGIN + stretch * (m.time - _ORIGIN)) for m in messages]
    order = random.permutation(len(messages))
    return [messages[i]._replace(time=messages[j].time) for i, j in zip(order, range(len(order)))]


def _names(random: Random, messages: list[Recorded], kinds: dict[str, str]) -> list[Recorded]:
    """Give the joints other names, or other numbers of them."""
    count = int(random.choice([0, 1, 2, 7, 40, 300]))
    names = [str(random.choice(_NAMES)) + ('' if random.random() < 0.3 else str(i))
             for i in range(count)]
    state = serialize_message(JointState(
        name=names, position=random.normal(size=count).tolist()))
    share = random.choice([0.1, 1.0])
    return [m._replace(raw=state) if kinds.get(m.topic) == _STATE and random.random() < share
            else m for m in messages]


def _configuration(
    random: Random, messages: list[Recorded], kinds: dict[str, str],
) -> list[Recorded]:
    """Put something else into the configuration or the robot description."""
    text = sound()[1]
    what = random.integers(5)
    if what == 0:
        text = str(random.choice(_YAML))
    elif what == 1:
        lines = text.splitlines()
        at = int(random.integers(len(lines)))
        head = lines[at].split(':')[0]
        value = random.choice(['3', '-1', '.nan', '[]', '{}', 'x', 'null', '1e400'])
        lines[at] = f'{head}: {value}'
        text = '\n'.join(lines)
    elif what == 2:
        text = damaged(random, text.encode()).decode(errors='replace')
    elif what == 3:
        text = text.replace(str(random.choice(['theta4', 'link', 'revolute', '0.1', 'rate: 250'])),
                            str(random.choice(['x', '1e300', '</script>', '-5', 'rate: 1e9'])))
    else:
        text = text[:200] + 'x' * int(random.choice([10, 100_000, 3_000_000])) + text[200:]
    raw = serialize_message(String(data=text.encode(errors='replace').decode().replace('\0', '')))
    topics = ('/planner_node/configuration', '/robot_description')[:int(random.integers(1, 3))]
    return [m._replace(raw=raw) if m.topic in topics else m for m in messages]


def _ticks(random: Random, messages: list[Recorded], kinds: dict[str, str]) -> list[Recorded]:
    """Put other numbers into some ticks."""
    def changed(random: Random, message: Recorded) -> Recorded:
        # Another attack may have cut it.
        end = message.raw[len(message.raw) % 8:][-160:]
        numbers: npt.NDArray[np.float64] = np.frombuffer(end or bytes(8)).copy()
        numbers[random.integers(len(numbers))] = random.choice(_NUMBERS)
        if random.random() < 0.2:
            numbers = numbers[:int(random.integers(len(numbers)))]
        return message._replace(raw=serialize_message(Float64MultiArray(data=numbers.tolist())))

    return [changed(random, m) if m.topic.endswith('ticks') and random.random() < 0.2 else m
            for m in messages]


def _types(random: Random, messages: list[Recorded], kinds: dict[str, str]) -> list[Recorded]:
    """Give a topic another type, or another name, or messages of another."""
    topic, other = (str(t) for t in random.choice(list(KINDS), size=2))
    what = random.integers(3)
    if what == 0:
        kinds[topic] = KINDS[other]
    elif what == 1:
        raws = [m.raw for m in messages if m.topic == other] or [b'']
        messages = [m._replace(raw=raws[int(random.integers(len(raws)))])
                    if m.topic == topic else m for m in messages]
    else:
        doubled = f'/left{topic}'
        kinds[doubled] = KINDS[other]
        messages = messages + [m._replace(topic=doubled) for m in messages if m.topic == other]
    return messages


def _dropped(random: Random, messages: list[Recorded], kinds: dict[str, str]) -> list[Recorded]:
    """Lose a topic, or most messages."""
    topic = str(random.choice(list(KINDS)))
    if random.random() < 0.7:
        return [m for m in messages if m.topic != topic]
    return [m for m in messages if random.random() < 0.02]


CHANGES: tuple[Callable[[Random, list[Recorded], dict[str, str]], list[Recorded]], ...] = (
    partial(_some, _number), partial(_some, _number),
    partial(_some, lambda random, m: m._replace(raw=damaged(random, m.raw))),
    partial(_some, lambda random, m: m._replace(raw=random.bytes(int(random.integers(60))))),
    _times, _times, _names, _configuration, _configuration, _ticks, _types, _dropped)
