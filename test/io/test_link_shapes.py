"""Capsules from the collision geometry of URDFs, meshes and primitives."""

from __future__ import annotations

from dataclasses import replace
import itertools
from pathlib import Path
import re
import shutil
import struct

from conftest import EXAMPLE_ROBOTS, examples, PANDA_URDF, planar_urdf
from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
import pytest
from scipy.spatial import ConvexHull
import yaml

from redundant_planner.core.errors import PlannerError, RobotError
from redundant_planner.core.robot.capsule_fit import distances, Shape
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.simulated_arm import joint_ranges, SimulatedArm
from redundant_planner.core.robot.urdf import read_urdf
from redundant_planner.core.target.start_posture import start_posture
from redundant_planner.io import link_shapes
from redundant_planner.io.collision_geometry import collision_elements, collision_pieces
from redundant_planner.io.hand_openings import openings_of
from redundant_planner.io.likely_tips import likely_tip
from redundant_planner.io.link_shapes import fitted_capsules
from redundant_planner.io.link_surfaces import link_surfaces
from redundant_planner.io.node_parameters import FakeHardwareParameters
from redundant_planner.io.parameter_files import (
    read_parameter_file,
    read_robot_parameters,
    RobotParameters,
    settings_of,
    urdf_text,
)
from redundant_planner.io.physics_parameters import MujocoHardwareParameters
from redundant_planner.io.resources import resolve
from redundant_planner.io.robot_files import build_robot, load_robot
from redundant_planner.tools.show_robot import main as show_robot

ARMS = {
    'panda_description/urdf/panda.urdf': 'panda_hand',
    'xarm_description/urdf/xarm7.urdf': 'link_eef',
    'ur_description/urdf/ur5_robot.urdf': 'tool0',
    'kinova_description/robots/kinova.urdf': 'j2s6s200_link_finger_tip_2',
    'z1_description/urdf/z1.urdf': 'gripperMover',
    'tiago_description/robots/tiago_no_hand.urdf': 'wrist_ft_tool_link',
}


@pytest.mark.first_alone
@pytest.mark.parametrize(('file', 'tip'), ARMS.items(), ids=[f.split('_')[0] for f in ARMS])
def test_every_corner_of_an_arms_geometry_is_inside(file, tip):
    path = EXAMPLE_ROBOTS / file
    text = path.read_text()
    assert likely_tip(text) == tip
    robot = Robot(text, tip, capsules=[], velocity_max=1.0)
    fits = {fit.joint: fit for fit in fitted_capsules(robot, path.parent, cache=False)}
    for piece in collision_pieces(robot, path.parent):
        fit = fits[piece.joint]
        points = robot.in_link(fit.capsules[0].frame, piece.link, piece.points)
        outside = np.min([distances(points, Shape(c.start, c.end, c.radius)) - c.radius
                          for c in fit.capsules], axis=0)
        assert outside.max() <= 0.0, piece.link
    ratios = [fit.ratio for fit in fits.values()]
    assert np.median(ratios) < 2.3 and all(
        len(fits[name].capsules) < 5 for name in robot.joint_names)


HANDS = {'panda_description/urdf/panda.urdf': 'panda_hand',
         'baxter_description/urdf/baxter.urdf': 'left_gripper_base_link',
         'pr2_description/urdf/pr2.urdf': 'r_gripper_palm_link'}


def outside_of_hand(fits, robot, folder, share):
    """How far the hand's corners are outside of its capsules, opened by a share, at most [m]."""
    joints = {joint.name: joint for joint in read_urdf(robot.urdf).joints}
    opened = Robot(robot.urdf, robot.tip_frame, capsules=[], velocity_max=1.0, locked_positions={
        name: (1.0 - share) * joints[name].lower + share * joints[name].upper
        for name in openings_of(robot, {}).joints})
    fit = next(fit for fit in fits if fit.joint == robot.joint_names[-1])
    base = fit.capsules[0].frame
    return max(float(np.min([
        distances(opened.in_link(base, piece.link, piece.points), Shape(c.start, c.end, c.radius))
        - c.radius for c in fit.capsules], axis=0).max())
        for piece in collision_pieces(robot, folder) if piece.joint == fit.joint)


@pytest.mark.first_alone
@pytest.mark.parametrize(('file', 'tip'), HANDS.items(), ids=[f.split('_')[0] for f in HANDS])
def test_the_capsules_of_a_hand_hold_at_any_opening(file, tip):
    path = EXAMPLE_ROBOTS / file
    robot = Robot(path.read_text(), tip, capsules=[], velocity_max=1.0)
    fits = fitted_capsules(robot, path.parent, cache=False)
    for share in (0.0, 0.03, 0.21, 0.5, 0.77, 0.97, 1.0):
        assert outside_of_hand(fits, robot, path.parent, share) <= 0.0, share


def test_a_hand_that_is_locked_has_capsules_for_that_opening_alone():
    robot = Robot(PANDA_URDF.read_text(), 'panda_hand', capsules=[])
    shut = fitted_capsules(robot, PANDA_URDF.parent, held={'panda_finger_joint1': 0.0},
                           cache=False)
    assert outside_of_hand(shut, robot, PANDA_URDF.parent, 0.0) <= 0.0
    assert outside_of_hand(shut, robot, PANDA_URDF.parent, 1.0) > 0.01
    assert openings_of(robot, {}).joints == ('panda_finger_joint1',)
    assert openings_of(robot, {'panda_finger_joint1': 0.0}).joints == ()


def test_a_round_finger_that_turns_is_covered_between_the_looks_too():
    """A bar of 0.3 m with a ball at its end, turning by 3 rad: what it sweeps is bent."""
    text = planar_urdf().replace('<link name="tip"/>', (
        '<link name="tip"/><link name="finger"><collision><origin xyz="0.3 0 0"/>'
        '<geometry><sphere radius="0.02"/></geometry></collision></link>'
        '<joint name="knuckle" type="revolute"><parent link="link3"/><child link="finger"/>'
        '<axis xyz="0 0 1"/><limit lower="-1.5" upper="1.5" velocity="1" effort="1"/></joint>'))
    robot = Robot(text, 'tip', capsules=[], axes=('vx', 'vy'))
    _, bulge = openings_of(robot, {}).points_of('link3', 'finger', np.array([[0.3, 0.0, 0.0]]))
    assert bulge == pytest.approx(0.3 * (1.0 - np.cos(0.5 * 3.0 / 16)), rel=1e-6)
    (fit,) = fitted_capsules(robot, None, cache=False)
    base = fit.capsules[0].frame
    ball = np.random.default_rng(0).normal(size=(300, 3))
    ball *= 0.02 / np.linalg.norm(ball, axis=1, keepdims=True)
    for angle in np.linspace(-1.5, 1.5, 97):
        turned = Robot(text, 'tip', capsules=[], axes=('vx', 'vy'),
                       locked_positions={'knuckle': angle})
        points = turned.in_link(base, 'finger', np.array([0.3, 0.0, 0.0]) + ball)
        outside = np.min([distances(points, Shape(c.start, c.end, c.radius)) - c.radius
                          for c in fit.capsules], axis=0)
        assert outside.max() <= 0.0, angle


def arm_with(geometry):
    """A planar arm whose middle link has one collision element."""
    return planar_urdf().replace('<link name="link2"/>', (
        '<link name="link2"><collision><origin xyz="0.1 0 0" rpy="0 1.5707963 0"/>'
        f'<geometry>{geometry}</geometry></collision></link>'))


@pytest.mark.parametrize(('geometry', 'expected'), [
    ('<sphere radius="0.07"/>', Shape(np.array([0.1, 0, 0]), np.array([0.1, 0, 0]), 0.07)),
    ('<cylinder radius="0.02" length="0.8"/>', None), ('<box size="0.1 0.2 0.9"/>', None)])
def test_primitives_stand_where_their_origin_puts_them(geometry, expected):
    robot = Robot(arm_with(geometry), 'tip', capsules=[], axes=('vx', 'vy'))
    (fit,) = fitted_capsules(robot, None, cache=False)
    (capsule,) = fit.capsules
    assert (capsule.frame, capsule.name, fit.joint) == ('link2', 'link2', 'joint2')
    middle = 0.5 * (capsule.start + capsule.end)
    np.testing.assert_allclose(middle, [0.1, 0.0, 0.0], atol=5e-3)
    if expected is not None:
        assert capsule.radius == pytest.approx(expected.radius, abs=3e-5)
    else:  # the element's z axis points along the link's x axis
        along = np.abs(capsule.end - capsule.start)
        assert along[0] > 10.0 * along[1:].max()


def tetrahedron(path, size=1.0):
    """Write a mesh with its corners at the origin and at `size` on every axis."""
    corners = np.vstack((np.zeros(3), np.diag([size] * 3)))
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    data = b'\0' * 80 + struct.pack('<I', len(faces))
    for face in faces:
        data += struct.pack('<12fH', *np.zeros(3), *corners[list(face)].ravel(), 0)
    path.write_bytes(data)


@pytest.mark.parametrize('location', ['mesh.stl', 'package://{package}/urdf/mesh.stl',
                                      'file://{folder}/mesh.stl'])
def test_meshes_are_found_relative_by_package_and_by_file_and_scaled(tmp_path, location):
    folder = tmp_path / 'my_arm' / 'urdf'
    folder.mkdir(parents=True)
    tetrahedron(folder / 'mesh.stl')
    name = location.format(package='my_arm', folder=folder)
    robot = Robot(arm_with(f'<mesh filename="{name}" scale="0.1 0.2 0.3"/>'), 'tip', capsules=[],
                  axes=('vx', 'vy'))
    points = np.vstack([p.points for p in collision_pieces(robot, folder)])
    size = points.max(axis=0) - points.min(axis=0)
    np.testing.assert_allclose(np.sort(size), [0.1, 0.2, 0.3], atol=1e-6)


def collada_cube(path, unit='<unit name="centimeter" meter="0.01"/>', size=10.0):
    """Write a cube between the origin and (size, size, size), which lies on its side in it."""
    corners = size * np.array(np.meshgrid((0, 1), (0, 1), (0, 1))).reshape(3, -1).T
    faces = ConvexHull(corners).simplices
    numbers, indices = (' '.join(map(str, array.ravel())) for array in (corners, faces))
    path.write_text(f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><contributor/>{unit}<up_axis>Y_UP</up_axis></asset>
  <library_geometries><geometry id="cube"><mesh>
    <source id="places"><float_array id="numbers" count="24">{numbers}</float_array>
      <technique_common><accessor source="#numbers" count="8" stride="3">
        <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common></source>
    <vertices id="corners"><input semantic="POSITION" source="#places"/></vertices>
    <triangles count="12"><input semantic="VERTEX" source="#corners" offset="0"/>
      <p>{indices}</p></triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="scene"><node id="node">
    <instance_geometry url="#cube"/></node></visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>""")


@pytest.mark.parametrize(('unit', 'scale', 'edge'), [
    ('<unit name="centimeter" meter="0.01"/>', '', 0.1), ('<unit meter="1"/>', '', 10.0),
    ('<unit meter="0.0254"/>', 'scale="2 2 2"', 0.508), ('<unit name="meter"/>', '', 10.0),
    ('', 'scale="0.01 0.01 0.01"', 0.1)])
def test_the_unit_of_a_collada_file_counts_and_its_up_axis_does_not(tmp_path, unit, scale, edge):
    """Case 8 of the inputs that users have: as RViz shows it."""
    collada_cube(tmp_path / 'cube.dae', unit)
    robot = Robot(arm_with(f'<mesh filename="cube.dae" {scale}/>'), 'tip', capsules=[],
                  axes=('vx', 'vy'))
    (piece,) = collision_pieces(robot, tmp_path)
    # The element's z axis points along the link's x axis, and x along −z.
    np.testing.assert_allclose(piece.points.min(axis=0), [0.1, 0.0, -edge], atol=1e-5 * edge)
    np.testing.assert_allclose(piece.points.max(axis=0), [0.1 + edge, edge, 0.0],
                               atol=1e-5 * edge)
    (fit,) = fitted_capsules(robot, tmp_path, cache=False)
    (capsule,) = fit.capsules
    assert capsule.radius == pytest.approx(0.77 * edge, rel=0.02)
    # What is drawn is the same.
    (surface,) = link_surfaces(robot, tmp_path)
    np.testing.assert_allclose(np.ptp(surface.vertices, axis=0), edge, rtol=1e-5)


@pytest.mark.parametrize('meter', ['0', '-0.01', 'nan', 'inf', 'one', ''])
def test_a_unit_that_is_none_is_refused_by_link_and_file(tmp_path, meter):
    collada_cube(tmp_path / 'cube.dae', f'<unit meter="{meter}"/>')
    robot = Robot(arm_with('<mesh filename="cube.dae"/>'), 'tip', capsules=[], axes=('vx', 'vy'))
    message = rf"mesh of link 'link2': '.*cube\.dae' has <unit meter='{meter}'>; it takes a pos"
    for read in (collision_pieces, link_surfaces):
        with pytest.raises(RobotError, match=message):
            read(robot, tmp_path)


@pytest.mark.parametrize('unit', ['<unit meter="0.01"/>', '<unit meter="1"/>'])
def test_a_link_that_is_larger_than_the_rest_of_the_arm_is_named(tmp_path, unit):
    """The parameters list the capsules, or they are fitted: it is looked at either way."""
    collada_cube(tmp_path / 'cube.dae', unit)
    urdf = tmp_path / 'arm.urdf'
    urdf.write_text(arm_with('<mesh filename="cube.dae"/>'))
    parameters = RobotParameters(urdf=str(urdf), tip_frame='tip', axes=('vx', 'vy'))
    said, again = [], []
    robot = build_robot(parameters, urdf.read_text(), {}, warn=said.append)
    entries = {c.name: link_shapes.capsule_entry(c) for c in robot.capsules}
    build_robot(replace(parameters, capsules=tuple(entries)), robot.urdf, entries,
                warn=again.append)
    assert again == said
    if '0.01' in unit:
        assert said == []
    else:
        (sentence,) = said
        # A ball around a cube of 10 m, or a capsule that is hardly longer.
        (length,) = re.findall(r"^the shape of link 'link2' is (\S+) m long, the rest of the arm "
                               r'1\.2 m: are the lengths in its mesh metres', sentence)
        assert 15.0 < float(length) < 20.0


def test_no_arm_of_example_robot_data_has_a_link_that_is_named_so():
    for file, tip in ARMS.items():
        parameters = RobotParameters(
            urdf=str(EXAMPLE_ROBOTS / file), tip_frame=tip, velocity_max=(1.0,))
        robot = build_robot(parameters, urdf_text(parameters), {})
        assert robot.capsules and link_shapes.larger_than_the_rest(robot) == [], file


def test_what_is_missing_is_named(tmp_path):
    gone = Robot(arm_with('<mesh filename="gone.stl"/>'), 'tip', capsules=[], axes=('vx', 'vy'))
    with pytest.raises(RobotError, match=r"mesh of link 'link2': 'gone.stl' is not a file"):
        collision_pieces(gone, tmp_path)
    bare = Robot(planar_urdf(), 'tip', capsules=[], axes=('vx', 'vy'))
    with pytest.raises(RobotError, match=r"link_radius \(in a file with 'link_shapes: straight'"):
        collision_pieces(bare, None)


@pytest.mark.parametrize(('geometry', 'message'), [
    ('<sphere radius="abc"/>', "sphere in the collision geometry of link 'link2' has radius='abc"),
    ('<sphere radius="nan"/>', "has radius='nan'"), ('<sphere radius="inf"/>', "radius='inf'"),
    ('<sphere radius="-0.1"/>', r'has the sizes \[-0.1\]; they must be positive'),
    ('<sphere radius="0"/>', 'must be positive'), ('<sphere/>', 'lacks radius; it takes a number'),
    ('<cylinder radius="0.1"/>', 'lacks length'), ('<box size="0.1 0.2"/>', "size='0.1 0.2'"),
    ('<box size="0.1 0.2 0"/>', 'must be positive'),
    ('<cone radius="0.1"/>', "link 'link2' has a <cone>, which no capsule can be fitted to"),
    ('', "link 'link2' holds 0 shapes; it takes one"),
    ('<sphere radius="0.1"/><sphere radius="0.1"/>', 'holds 2 shapes'),
    ('<mesh filename="~nouser/x"/>', "mesh of link 'link2': '~nouser/x' cannot be looked up"),
    (f'<mesh filename="{"x" * 5000}"/>', "mesh of link 'link2': 'xxx.*cannot be looked up"),
    ('<mesh filename="good.stl" scale="1 1 0"/>', "mesh of link 'link2' has a scale of 0"),
    ('<mesh filename="good.stl" scale="1 1"/>', "mesh of link 'link2' has scale='1 1'"),
    ('<mesh filename="nan.stl"/>', "mesh of link 'link2': .*nan.stl' has 4 vertices; it takes"),
    ('<mesh filename="huge.stl"/>', r"huge.stl' has 4 vertices; .* within ±10000 m"),
    ('<mesh filename="cut.stl"/>', "mesh of link 'link2': .*cut.stl' cannot be read"),
    ('<mesh filename="text.dae"/>', "mesh of link 'link2': .*text.dae' cannot be read"),
])
def test_a_collision_element_that_cannot_be_used_is_refused_by_its_link(
        tmp_path, geometry, message):
    tetrahedron(tmp_path / 'good.stl')
    tetrahedron(tmp_path / 'nan.stl', np.nan)
    tetrahedron(tmp_path / 'huge.stl', 1e30)
    (tmp_path / 'cut.stl').write_bytes((tmp_path / 'good.stl').read_bytes()[:100])
    (tmp_path / 'text.dae').write_text('no mesh')
    # A good element beside it must not hide the bad one.
    text = arm_with(geometry).replace('</link>', (
        '<collision><geometry><sphere radius="0.1"/></geometry></collision></link>'), 1)
    robot = Robot(text, 'tip', capsules=[], axes=('vx', 'vy'))
    with pytest.raises(RobotError, match=message):
        fitted_capsules(robot, tmp_path, cache=False)


@pytest.mark.parametrize('origin', ['xyz="nan 0 0"', 'xyz="0 0"', 'rpy="0 east 0"', 'rpy=""'])
def test_a_collision_element_that_stands_nowhere_is_refused(origin):
    text = arm_with('<sphere radius="0.1"/>').replace('xyz="0.1 0 0" rpy="0 1.5707963 0"', origin)
    robot = Robot(text, 'tip', capsules=[], axes=('vx', 'vy'))
    with pytest.raises(RobotError, match="origin of the collision geometry of link 'link2' has"):
        collision_pieces(robot, None)


def test_a_link_that_is_seen_but_has_no_collision_geometry_is_named():
    text = arm_with('<sphere radius="0.1"/>').replace(
        '<link name="link3"/>', '<link name="link3"><visual/></link>')
    said = []
    build_robot(RobotParameters(tip_frame='tip', axes=('vx', 'vy')), text, {}, warn=said.append)
    assert said == ["no collision geometry, so nothing keeps obstacles away: 'link3'"]


def box(*size):
    return f'<collision><geometry><box size="{" ".join(map(str, size))}"/></geometry></collision>'


def with_links_that_stand_still(links):
    """A planar arm: name → (parent, kind of joint, collision elements) of more links."""
    return planar_urdf().replace('</robot>', ''.join(
        f'<link name="{name}">{geometry}</link>'
        f'<joint name="{name}_joint" type="{kind}"><parent link="{parent}"/><child link="{name}"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        for name, (parent, kind, geometry) in links.items()) + '</robot>').replace(
            '<link name="link2"/>', f'<link name="link2">{box(0.3, 0.1, 0.1)}</link>')


@pytest.mark.first_alone
def test_what_is_fixed_to_the_base_is_covered_closely_or_named():
    text = with_links_that_stand_still({
        'socket': ('base', 'fixed', box(0.2, 0.2, 0.15)),
        'chest': ('socket', 'fixed', box(0.3, 0.45, 0.4)),
        'table': ('base', 'fixed', box(1.5, 0.8, 0.02)),
        # May come to stand elsewhere.
        'other_arm': ('base', 'revolute', box(0.1, 0.1, 0.1))})
    said = []
    robot = build_robot(RobotParameters(tip_frame='tip', axes=('vx', 'vy')), text, {},
                        warn=said.append)
    frames = [capsule.frame for capsule in robot.capsules]
    assert set(itertools.compress(frames, ~robot.moved)) == {'socket'}
    names = {capsule.name.partition('_')[0] for capsule in
             itertools.compress(robot.capsules, ~robot.moved)}
    assert names == {'socket', 'chest'}
    assert len(said) == 1 and "keeps the arm off them: 'table';" in said[0]
    # No point of a capsule is far out of the boxes.
    still = [piece for piece in collision_pieces(robot, None) if piece.joint == robot.base_frame]
    corners = {piece.link: piece.points for piece in still}
    random = np.random.default_rng(0)
    for capsule in itertools.compress(robot.capsules, ~robot.moved):
        half = corners[capsule.name.partition('_')[0]].max(axis=0)
        direction = random.normal(size=(2000, 3))
        direction *= capsule.radius / np.linalg.norm(direction, axis=1)[:, None]
        for end in (capsule.start, capsule.end):
            assert np.linalg.norm(
                np.maximum(np.abs(end + direction) - half, 0.0), axis=1).max() < 0.1002


def test_a_base_of_very_many_pieces_is_covered_as_far_as_that_takes_no_time():
    """Nobody's arm is refused for what it stands on."""
    ball = '<collision><geometry><sphere radius="0.03"/></geometry></collision>'
    text = with_links_that_stand_still({
        'rack': ('base', 'fixed', 90 * ball), 'cell': ('base', 'fixed', 400 * ball)})
    said = []
    robot = build_robot(RobotParameters(tip_frame='tip', axes=('vx', 'vy')), text, {},
                        warn=said.append)
    assert (~robot.moved).sum() == 100
    assert len(said) == 1 and "keeps the arm off them: 'cell';" in said[0]


def test_more_collision_elements_than_can_be_fitted_in_time_are_refused():
    many = '<collision><geometry><sphere radius="0.1"/></geometry></collision>' * 101
    text = planar_urdf().replace('<link name="link2"/>', f'<link name="link2">{many}</link>')
    with pytest.raises(RobotError, match="'joint2' carries have 101 collision elements"):
        collision_pieces(Robot(text, 'tip', capsules=[], axes=('vx', 'vy')), None)


@pytest.fixture
def cached(tmp_path, monkeypatch):
    """An arm whose fit is kept, the fit, and the file."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    robot = Robot(arm_with('<box size="0.1 0.2 0.3"/>'), 'tip', capsules=[], axes=('vx', 'vy'))
    fits = fitted_capsules(robot, None)
    (file,) = (tmp_path / 'redundant_planner').iterdir()
    return robot, fits, file


def numbers_of(fits):
    return [(fit.joint, fit.links, c.name, c.frame, *c.start, *c.end, c.radius)
            for fit in fits for c in fit.capsules]


def test_a_fit_is_kept_and_found_again(cached, monkeypatch):
    robot, fits, _ = cached
    with monkeypatch.context() as context:
        context.setattr(link_shapes, '_fit', None)  # whoever fits again, fails
        assert numbers_of(fitted_capsules(robot, None)) == numbers_of(fits)
    other = Robot(arm_with('<box size="0.1 0.2 0.4"/>'), 'tip', capsules=[], axes=('vx', 'vy'))
    assert numbers_of(fitted_capsules(other, None)) != numbers_of(fits)


def test_a_fit_with_a_joint_locked_elsewhere_is_another_one(tmp_path, monkeypatch):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    text = arm_with('<sphere radius="0.1"/>').replace('<link name="link3"/>', (
        '<link name="link3"><collision><origin xyz="0.3 0 0"/><geometry><sphere radius="0.1"/>'
        '</geometry></collision></link>'))
    straight, bent = (
        fitted_capsules(Robot(text, 'tip', capsules=[], axes=('vx', 'vy'),
                              locked_positions={'joint3': angle}), None) for angle in (0.0, 1.5))
    assert numbers_of(straight) != numbers_of(bent)


@given(data=st.data())
@settings(max_examples=examples(40), deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_cache_is_recognised_and_made_anew(cached, data):
    robot, fits, file = cached
    good = file.read_bytes()
    place = data.draw(st.integers(0, len(good) - 1))
    damaged = data.draw(st.sampled_from([
        b'', b'[]', b'{}', b'null', b'[' * 100_000, good[:place], good + b' ',
        good[:place] + bytes([good[place] ^ 1]) + good[place + 1:]]))
    file.write_bytes(damaged)
    assert numbers_of(fitted_capsules(robot, None)) == numbers_of(fits)
    assert file.read_bytes() == good


@pytest.mark.parametrize('content', ['[]', '[{}]', '{}', 'null', '{"joint": 1}'])
def test_a_whole_cache_that_lacks_links_is_made_anew(cached, content):
    robot, fits, file = cached
    key = link_shapes._key(robot, collision_elements(robot, None), openings_of(robot, {}))
    good = file.read_bytes()
    file.write_bytes(link_shapes._seal(key, content.encode()) + b'\n' + content.encode())
    assert numbers_of(fitted_capsules(robot, None)) == numbers_of(fits)
    assert file.read_bytes() == good


def test_a_cache_that_cannot_be_written_leaves_nothing_behind(cached, monkeypatch):
    robot, fits, file = cached
    file.unlink()

    def full(*_):
        raise OSError('no space left on device')

    monkeypatch.setattr(link_shapes.os, 'replace', full)
    assert numbers_of(fitted_capsules(robot, None)) == numbers_of(fits)
    assert list(file.parent.iterdir()) == []


def test_show_robot_prints_a_parameter_file_that_loads(tmp_path, capsys):
    picture = tmp_path / 'panda.png'
    assert show_robot(['--urdf', str(PANDA_URDF), '--out', str(picture)]) == 0
    file = tmp_path / 'panda.yaml'
    file.write_text(capsys.readouterr().out)
    robot = load_robot(file)
    assert robot.tip_frame == 'panda_hand' and robot.n == 7
    assert 7 <= len(robot.capsules) <= 10 and picture.stat().st_size > 50_000


def test_show_robot_keeps_what_the_parameters_say(tmp_path, capsys):
    given = tmp_path / 'given.yaml'
    given.write_text(f"""
/**:
  ros__parameters:
    urdf: {PANDA_URDF}
    tip_frame: panda_hand
    axes: [vx, vy, vz]
    command_frame: tool
    locked_joints: ['panda_joint3=0.2']
    acceleration_max: [7.0]
""")
    assert show_robot(['--params', str(given), '--out', str(tmp_path / 'p.png')]) == 0
    printed = tmp_path / 'printed.yaml'
    printed.write_text(capsys.readouterr().out)
    robot = load_robot(printed)
    assert robot.n == 6 and robot.m == 3 and robot.command_frame == 'tool'
    assert 'panda_joint3' not in robot.joint_names
    np.testing.assert_array_equal(robot.acceleration_max, 7.0)


@pytest.mark.parametrize(('arguments', 'message'), [
    ([], 'give --urdf or --params'), (['--urdf', '/no/such.urdf'], 'is not a file'),
    (['--params', '/no/such.yaml'], 'cannot be read: No such file'),
    (['--urdf', str(PANDA_URDF), '--tip', 'nose'], "tip_frame 'nose'"),
    (['--urdf', str(PANDA_URDF), '--posture', '1'], 'posture has shape')])
def test_show_robot_says_in_one_line_what_is_wrong(arguments, message, capsys, tmp_path):
    assert show_robot([*arguments, '--out', str(tmp_path / 'x.png')]) == 2
    error = capsys.readouterr().err
    assert message in error and 'Traceback' not in error


def test_a_joint_that_mimics_another_stands_with_it():
    """Locked fingers: the follower stands at multiplier × leader + offset."""
    urdf = planar_urdf(('revolute', 'revolute', 'revolute')).replace('</robot>', (
        '<link name="a"/><link name="b"/>'
        '<joint name="lead" type="prismatic"><parent link="tip"/><child link="a"/>'
        '<axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint>'
        '<joint name="follow" type="prismatic"><parent link="tip"/><child link="b"/>'
        '<axis xyz="1 0 0"/><limit lower="-9" upper="9" velocity="1" effort="1"/>'
        '<mimic joint="lead" multiplier="2" offset="0.1"/></joint></robot>'))
    robot = Robot(urdf, 'tip', locked_positions={'lead': 0.3}, axes=('vx', 'vy'), capsules=[])
    along = robot.in_link('tip', 'b', np.zeros((1, 3)))[0]
    np.testing.assert_allclose(along, [0.7, 0.0, 0.0], atol=1e-12)
    with pytest.raises(RobotError, match=r"joint 'follow' .* mimics 'lead'"):
        Robot(urdf, 'b', axes=('vx', 'vy'))


def test_parameters_know_both_kinds_of_link_shapes():
    assert RobotParameters().link_shapes == 'fitted'


@pytest.mark.parametrize('options', [
    ['--urdf', 'folder'], ['--urdf', 'latin'], ['--urdf', '~nouser/arm.urdf'],
    ['--params', 'folder'], ['--params', 'latin'], ['--params', 'nothing.yaml'],
    ['--urdf', str(PANDA_URDF), '--out', 'folder/picture.shape'],
    ['--urdf', str(PANDA_URDF), '--out', 'nowhere/picture.png']])
def test_show_robot_says_in_a_line_what_it_cannot_read_or_write(
        tmp_path, monkeypatch, capsys, options):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'latin').write_bytes(b'<robot name="\xe9"/>')
    assert show_robot(options) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith('show_robot: ')


@pytest.fixture
def arm_beside_its_meshes(tmp_path, monkeypatch):
    """A folder `robots` with a URDF and its meshes, and the working directory in it."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    robots = tmp_path / 'robots'
    meshes = robots / 'my_arm' / 'meshes'
    meshes.mkdir(parents=True)
    source = EXAMPLE_ROBOTS / 'panda_description' / 'meshes' / 'collision' / 'link5.stl'
    shutil.copy(source, meshes / 'link.stl')
    monkeypatch.chdir(robots)
    return robots


@pytest.mark.first_alone
@pytest.mark.parametrize(('urdf', 'mesh'), [
    ('arm.urdf', 'my_arm/meshes/link.stl'),
    ('../robots/arm.urdf', 'package://my_arm/meshes/link.stl'),
    ('file://arm.urdf', 'package://robots/my_arm/meshes/link.stl'),
    ('link.urdf', 'package://robots/my_arm/meshes/link.stl')])
def test_a_relative_urdf_finds_its_meshes_and_its_file_works_anywhere(
        arm_beside_its_meshes, monkeypatch, capsys, urdf, mesh):
    robots = arm_beside_its_meshes
    robot = arm_with(f'<mesh filename="{mesh}"/>')
    (robots / 'arm.urdf').write_text(robot)
    (robots.parent / 'elsewhere').mkdir()
    (robots / 'link.urdf').symlink_to('arm.urdf')
    assert show_robot(['--urdf', urdf, '--tip', 'tip', '--out', 'arm.svg']) == 0
    captured = capsys.readouterr()
    assert 'no meshes in the picture' not in captured.err
    file = robots.parent / 'elsewhere' / 'arm.yaml'
    file.write_text(captured.out)
    monkeypatch.chdir(robots.parent / 'elsewhere')
    parameters = read_robot_parameters(file)[0]
    # As the nodes read it: from their working directory.
    assert Path(parameters.urdf).is_absolute() and urdf_text(parameters) == robot
    assert load_robot(file).n == 3
    # Fitted anew where somebody has taken the capsules out.
    bare = replace(parameters, capsules=())
    assert len(build_robot(bare, urdf_text(bare), {}).capsules) >= 1


def test_an_installed_package_counts_before_a_folder_of_its_name(tmp_path, monkeypatch):
    """But the package that the URDF lies in counts before both."""
    def file(*parts):
        path = tmp_path.joinpath(*parts, 'mesh.stl')
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text('')
        return path

    beside, installed = file('ws', 'my_arm'), file('prefix', 'share', 'my_arm')
    folder = tmp_path / 'ws' / 'robots'
    folder.mkdir()
    assert resolve('package://my_arm/mesh.stl', folder) == beside
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'prefix'))
    assert resolve('package://my_arm/mesh.stl', folder) == installed
    assert resolve('package://my_arm/mesh.stl', beside.parent) == beside
    installed.unlink()
    assert resolve('package://my_arm/mesh.stl', folder) == beside
    with pytest.raises(PlannerError, match=r"looked at '.*prefix/share/my_arm/no\.stl'"):
        resolve('package://my_arm/no.stl', folder)


@pytest.mark.long
def test_show_robot_writes_a_start_that_both_simulated_arms_take(tmp_path, capsys):
    arguments = ['--urdf', str(PANDA_URDF), '--out', str(tmp_path / 'p.png')]
    assert show_robot(arguments) == 0
    file = tmp_path / 'panda.yaml'
    file.write_text(capsys.readouterr().out)
    values, robot = read_parameter_file(file), load_robot(file)
    for kind in (FakeHardwareParameters, MujocoHardwareParameters):
        simulated = settings_of(kind, values)
        start = dict(zip(simulated.initial_joints, simulated.initial_positions))
        arm = SimulatedArm(joint_ranges(robot.urdf), start, command_timeout=0.1)
        q = arm.q[[arm.ranges.names.index(name) for name in robot.joint_names]]
        np.testing.assert_array_equal(q, start_posture(robot))
    # A start of the user's own is kept, and so is one on the command line.
    file.write_text(file.read_text().replace('initial_positions: [', 'initial_positions: [0.25, ')
                    .replace('initial_joints: [', 'initial_joints: [panda_finger_joint1, ')
                    .replace('[0.25, ', '[0.02, '))
    assert show_robot(['--params', str(file), *arguments[2:]]) == 0
    kept = yaml.safe_load(capsys.readouterr().out)['/**']['ros__parameters']
    assert kept['initial_positions'] == [0.02, *start.values()]
    given = ['0', '-0.5', '0', '-2', '0', '1.5', '0.7']
    assert show_robot([*arguments, '--posture', *given]) == 0
    chosen = yaml.safe_load(capsys.readouterr().out)['/**']['ros__parameters']
    assert chosen['initial_positions'] == [float(number) for number in given]


def test_locked_joints_start_where_they_are_locked(tmp_path, capsys):
    file = tmp_path / 'given.yaml'
    file.write_text(f'/**: {{ros__parameters: {{urdf: {PANDA_URDF}, tip_frame: panda_hand, '
                    'locked_joints: [panda_joint3=0.2]}}')
    assert show_robot(['--params', str(file), '--out', str(tmp_path / 'p.png')]) == 0
    values = yaml.safe_load(capsys.readouterr().out)['/**']['ros__parameters']
    start = dict(zip(values['initial_joints'], values['initial_positions']))
    assert start['panda_joint3'] == 0.2 and len(start) == 7
