"""Robots: spoilt URDFs and meshes, and what is built from those that are taken."""

from __future__ import annotations

from collections.abc import Callable
import functools
import os
from pathlib import Path
import struct
import sysconfig
import xml.etree.ElementTree as ElementTree

import numpy as np
import yaml

from benchmark.fuzz.mutations import NUMBERS, pick, spoilt_bytes, spoilt_numbers
from benchmark.fuzz.tally import Tally
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import AXES, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.capsule_fit import distances, Shape
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.simulated_arm import joint_ranges, SimulatedArm
from redundant_planner.io.collision_geometry import collision_pieces
from redundant_planner.io.likely_tips import likely_tip
from redundant_planner.io.link_shapes import fitted_capsules
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.resources import share_directory
from redundant_planner.io.robot_files import build_robot
from redundant_planner.tools.show_robot import parameter_file

_PANDA = (Path(sysconfig.get_paths()['purelib']) / 'cmeel.prefix' / 'share' / 'example-robot-data'
          / 'robots' / 'panda_description' / 'urdf' / 'panda.urdf')
_TICKS, _DT = 5, 0.004
# Round-off that no limit is exceeded by.
_ROUND_OFF = 1e-6

_SHAPES = ('<sphere radius="0.05"/>', '<box size="0.1 0.05 0.2"/>',
           '<cylinder radius="0.04" length="0.2"/>', '<capsule radius="0.04" length="0.2"/>',
           '<mesh filename="mesh.stl"/>', '<mesh filename="mesh.obj" scale="0.5 -1 1"/>',
           '<mesh filename="mesh.dae" scale="1 1 0.5"/>')
_BAD_SHAPES = (
    '', '<sphere/>', '<sphere radius="nan"/>', '<sphere radius="-1"/>', '<sphere radius="abc"/>',
    '<box size="0.1 0.1"/>', '<box size="0 0 0"/>', '<cylinder radius="0.1"/>', '<cone/>',
    '<cylinder radius="0.1" length="inf"/>', '<mesh/>', '<mesh filename="~nobody/x"/>',
    f'<mesh filename="{"x" * 5000}"/>', '<mesh filename="mesh.stl" scale="0 0 0"/>',
    '<mesh filename="mesh.stl" scale="1e300 1 1"/>', '<mesh filename="package:///"/>',
    '<mesh filename="package://../x"/>', '<mesh filename="."/>', '<mesh filename="/dev/zero"/>',
    '<sphere radius="1"/><sphere radius="1"/>', '<sphere radius="1e300"/>',
    '<sphere radius="1e-300"/>', '<octree/>')
_LIMITS = ('lower', 'upper', 'velocity', 'acceleration', 'deceleration', 'jerk')
_RANGES = ((), (), ('joint1=-1..1',), ('joint1=-9..1e2',), ('joint1=0.1..0.2', 'joint2=-1..2'))
_KINDS = ('revolute', 'continuous', 'prismatic', 'fixed', 'floating', 'planar', 'hinge', '')

# In centimetres; to be filled with places and indices.
_COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="0.01"/></asset><library_geometries><geometry id="g"><mesh><source id="s">
<float_array id="a" count="12">{}</float_array><technique_common>
<accessor source="#a" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices><triangles count="4">
<input semantic="VERTEX" source="#v" offset="0"/><p>{}</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="w"><node id="n">
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>"""


def attack(random: np.random.Generator, folder: Path, tally: Tally) -> None:
    """Spoil one robot, and try everything that reads it."""
    os.environ['XDG_CACHE_HOME'] = str(folder)
    text, tip = _robot(random, folder)
    spoil = pick(random, (_text, _numbers, _numbers, _structure, _structure, _shapes,
                          _shapes, _meshes, _size, _nothing))
    text = spoil(random, folder, text)
    tally.attempt(lambda: likely_tip(text))
    ranges = tally.attempt(lambda: joint_ranges(text))
    if ranges is not None:
        tally.attempt(lambda: SimulatedArm(ranges, {}, command_timeout=0.1))
    file = folder / 'arm.urdf'
    file.write_text(text, errors='replace')
    straight = bool(random.random() < 0.3)
    parameters = RobotParameters(
        urdf=str(file), tip_frame=tip, velocity_max=() if random.random() < 0.8 else (1.0,),
        axes=AXES[:int(random.integers(1, 7))], link_radius=0.03,
        link_shapes='straight' if straight else 'fitted', position_limits=pick(random, _RANGES))
    robot = tally.attempt(lambda: build_robot(parameters, file.read_text(), {}))
    if robot is None:
        return
    tally.check_finite(
        robot.velocity_max, robot.acceleration_max, robot.lever_arm_bounds,
        *(np.array([*c.start, *c.end, c.radius]) for c in robot.capsules))
    if not straight:
        tally.attempt(lambda: _covered(robot, text, folder))
    tally.attempt(lambda: yaml.safe_load(parameter_file(parameters, robot)))
    tally.attempt(lambda: _moved(robot, random, tally))


def _covered(robot: Robot, text: str, folder: Path) -> None:
    """Hold the capsules to the collision geometry that the URDF has."""
    links = {link.get('name'): link for link in ElementTree.fromstring(text).findall('link')}
    pieces = collision_pieces(robot, folder)
    for link in robot.moving_links:
        written = len(links[link].findall('collision')) if link in links else 0
        assert written == sum(piece.link == link for piece in pieces), f'{link}: elements dropped'
    bare = {link for fit in fitted_capsules(robot, folder) for link in fit.bare}
    for piece in (piece for piece in pieces if piece.link not in bare):
        outside = np.full(len(piece.points), np.inf)
        for capsule in robot.capsules:
            if robot.moving_links.get(capsule.frame, robot.base_frame) == piece.joint:
                points = robot.in_link(capsule.frame, piece.link, piece.points)
                outside = np.minimum(outside, distances(points, Shape(
                    capsule.start, capsule.end, capsule.radius)) - capsule.radius)
        reach = float(np.abs(piece.points).max())
        assert outside.max() <= 1e-9 * max(reach, 1.0), f'{piece.link}: {outside.max()} m outside'


def _moved(robot: Robot, random: np.random.Generator, tally: Tally) -> None:
    """Take some ticks, and hold the velocities to their limits."""
    planner = Planner(robot, PlannerParameters())
    low = np.where(np.isfinite(robot.position_min), robot.position_min, -3.0)
    high = np.where(np.isfinite(robot.position_max), robot.position_max, 3.0)
    q = random.uniform(low, high)
    twist = random.normal(0.0, 0.1, 6)
    before = np.zeros(robot.n)
    for _ in range(_TICKS):
        dq = planner.step(q, twist, Scene.of([]), _DT).dq
        if not tally.check_finite(dq):
            return
        tally.limit_violations += bool(
            (np.abs(dq) > robot.velocity_max * (1.0 + _ROUND_OFF)).any()
            or (np.abs(dq - before) > robot.acceleration_max * _DT * (1.0 + _ROUND_OFF)).any())
        q, before = q + dq * _DT, dq


@functools.cache
def _example(name: str) -> str:
    return {'panda': _PANDA, 'paper': share_directory() / 'config' / 'robots'
            / 'paper_2p5r.urdf'}[name].read_text()


def _robot(random: np.random.Generator, folder: Path) -> tuple[str, str]:
    """Return a URDF and its tip: the Panda, the paper's arm, or a small one."""
    chance = random.random()
    if chance < 0.1:
        text = _example('panda').replace('package://example-robot-data/robots',
                                         str(_PANDA.parents[2]))
        return text, 'panda_hand'
    if chance < 0.3:
        return _example('paper'), 'tool_tip'
    _write_meshes(folder)
    parts = ['<robot name="small"><link name="base"/>']
    count = int(random.integers(1, 8))
    for i in range(1, count + 1):
        kind = pick(random, _KINDS[:3])
        axis = pick(random, ('1 0 0', '0 1 0', '0 0 1', '0.6 0.8 0', '1 1 1'))
        shape = pick(random, _SHAPES)
        parts.append(
            f'<link name="link{i}"><visual/><collision><origin xyz="0.05 0 0" rpy="0 0.3 0"/>'
            f'<geometry>{shape}</geometry></collision></link>'
            f'<joint name="joint{i}" type="{kind}"><origin xyz="0.2 0 0.1" rpy="0.1 0 0"/>'
            f'<parent link="{"base" if i == 1 else f"link{i - 1}"}"/><child link="link{i}"/>'
            f'<axis xyz="{axis}"/><limit lower="-2.5" upper="2.5" velocity="2" effort="1"/>'
            '</joint>')
    parts.append(f'<link name="tip"/><joint name="end" type="fixed"><parent link="link{count}"/>'
                 '<child link="tip"/><origin xyz="0.2 0 0"/></joint></robot>')
    return ''.join(parts), 'tip'


def _write_meshes(folder: Path) -> None:
    corners = 0.1 * np.vstack((np.zeros(3), np.eye(3)))
    faces = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    stl = b'\0' * 80 + struct.pack('<I', len(faces)) + b''.join(
        struct.pack('<12fH', *np.zeros(3), *corners[list(face)].ravel(), 0) for face in faces)
    (folder / 'mesh.stl').write_bytes(stl)
    lines = [f'v {x} {y} {z}' for x, y, z in corners]
    lines += [f'f {a + 1} {b + 1} {c + 1}' for a, b, c in faces]
    (folder / 'mesh.obj').write_text('\n'.join(lines))
    places, indices = (' '.join(map(str, np.ravel(array))) for array in (100.0 * corners, faces))
    (folder / 'mesh.dae').write_text(_COLLADA.format(places, indices))


def _nothing(random: np.random.Generator, folder: Path, text: str) -> str:
    return text


def _text(random: np.random.Generator, folder: Path, text: str) -> str:
    return spoilt_bytes(random, text.encode()).decode(errors='replace')


def _numbers(random: np.random.Generator, folder: Path, text: str) -> str:
    return spoilt_numbers(random, text)


def _meshes(random: np.random.Generator, folder: Path, text: str) -> str:
    """Spoil the mesh files of a small arm."""
    collada = folder / 'mesh.dae'
    if collada.is_file():
        # Its unit alone, which this package reads.
        collada.write_text(collada.read_text().replace('"0.01"', f'"{pick(random, NUMBERS)}"'))
    for name in ('mesh.stl', 'mesh.obj'):
        file = folder / name
        if file.is_file():
            content = file.read_bytes()
            if random.random() < 0.3 and name.endswith('stl'):
                # A corner somewhere else, in a file that is otherwise whole.
                place = 84 + 50 * int(random.integers(4)) + 12 + 4 * int(random.integers(9))
                value = float(pick(random, (np.nan, np.inf, 1e30, 1e-40, -1e5, 0.0)))
                content = content[:place] + struct.pack('<f', value) + content[place + 4:]
                file.write_bytes(content)
            elif random.random() < 0.3 and name.endswith('obj'):
                file.write_text(spoilt_numbers(random, content.decode()))
            else:
                file.write_bytes(spoilt_bytes(random, content))
    return text


def _structure(random: np.random.Generator, folder: Path, text: str) -> str:
    """Remove, repeat, move or rename elements."""
    root = ElementTree.fromstring(text)
    for _ in range(int(random.integers(1, 4))):
        joints, links = root.findall('joint'), root.findall('link')
        elements = [(parent, child) for parent in root.iter() for child in parent]
        if not elements or not joints or not links:
            break
        parent, child = pick(random, elements)
        joint, name = pick(random, joints), pick(random, links).get('name', '')
        leader = pick(random, joints).get('name', '')
        change: Callable[[], object] = pick(random, (
            lambda p=parent, c=child: p.remove(c),
            lambda p=parent, c=child: p.append(c),
            lambda c=child: c.clear(),
            lambda c=child: c.attrib.pop(pick(random, [*c.attrib, 'name']), None),
            lambda c=child, n=name: c.set('name', pick(random, ('', n, '\u202e', 'universe'))),
            lambda j=joint: j.set('type', pick(random, _KINDS)),
            lambda j=joint, n=name: [end.set('link', n) for end in j.findall('parent')],
            lambda j=joint, n=name: [end.set('link', n) for end in j.findall('child')],
            lambda j=joint, n=leader: ElementTree.SubElement(
                j, 'mimic', joint=n, multiplier=pick(random, NUMBERS)),
            lambda j=joint: [limit.set(pick(random, _LIMITS), pick(random, NUMBERS))
                             for limit in j.findall('limit')],
        ))
        change()
    return ElementTree.tostring(root, encoding='unicode')


def _shapes(random: np.random.Generator, folder: Path, text: str) -> str:
    """Give links other collision elements, good and bad."""
    root = ElementTree.fromstring(text)
    for _ in range(int(random.integers(1, 4))):
        link = pick(random, root.findall('link'))
        shape = pick(random, _BAD_SHAPES if random.random() < 0.5 else _SHAPES)
        numbers = ' '.join(pick(random, NUMBERS) if random.random() < 0.1 else '0.1'
                           for _ in range(3))
        link.append(ElementTree.fromstring(
            f'<collision><origin xyz="{numbers}"/><geometry>{shape}</geometry></collision>'))
    return ElementTree.tostring(root, encoding='unicode')


def _size(random: np.random.Generator, folder: Path, text: str) -> str:
    """Append very many links, joints, or nested elements."""
    count = int(pick(random, (30, 200, 900, 3000)))
    if random.random() < 0.2:
        return text.replace('</robot>', '<a>' * 100 * count + '</a>' * 100 * count + '</robot>')
    kind = pick(random, ('fixed', 'revolute'))
    parent = 'base' if '"base"' in text else ElementTree.fromstring(text)[0].get('name', '')
    chained = bool(random.random() < 0.5)
    return text.replace('</robot>', ''.join(
        f'<link name="more{i}"/><joint name="joins{i}" type="{kind}"><child link="more{i}"/>'
        f'<parent link="{f"more{i - 1}" if chained and i else parent}"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        for i in range(count)) + '</robot>')
