"""MoveIt's scene, message by message, against a composition of transforms by Pinocchio."""

from __future__ import annotations

from conftest import examples, make_panda
from hypothesis import given, settings, strategies as st
import numpy as np
import pinocchio as pin
import pytest
from rclpy.serialization import serialize_message
import scene_messages as m
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles.contacts import AllowedContacts
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.nodes.marker_topic import marker_message
from redundant_planner.perception import scene_markers as scene_markers_module
from redundant_planner.perception.planning_scene import with_attached, with_object, with_scene
from redundant_planner.perception.scene_contacts import allowed_contacts
from redundant_planner.perception.scene_markers import obstacle_ids, scene_markers
from redundant_planner.perception.scene_records import PlanningScene, Surroundings

PANDA = make_panda()
BASE, HAND = PANDA.base_frame, 'panda_hand'
CENTER = np.array([0.0, 0.0, 0.333])
def random_pose(rng):
    turn = rng.normal(size=4)
    return pin.SE3(pin.Quaternion(*(turn / np.linalg.norm(turn))), rng.uniform(-0.7, 0.7, 3))


_RNG = np.random.default_rng(9)
# Frames that somebody knows: the link that holds things, and one of a camera.
FRAMES = {'': pin.SE3.Identity(), BASE: pin.SE3.Identity(), HAND: random_pose(_RNG),
          'camera': random_pose(_RNG)}


def frame(name):
    if name not in FRAMES:
        raise ObstacleError(f'nobody knows {name}')
    return FRAMES[name].homogeneous


AROUND = Surroundings(frame, CENTER, 1.5)


def after(*messages, begin=None):
    """The scene after messages, and all that was said."""
    now, said = begin or PlanningScene(), []
    for message in messages:
        apply = (with_scene if hasattr(message, 'world') else
                 with_attached if hasattr(message, 'link_name') else with_object)
        now, problems = apply(now, message, AROUND)
        said += problems
    return now, said


def distances(shapes, points):
    """The distance of each point (k, 3) from the nearest of shapes: kind, half size, SE3 [m]."""
    all_of_them = []
    for kind, half, where in shapes:
        p = (points - where.translation) @ where.rotation
        if kind == 'box':
            q = np.abs(p) - half
        elif kind == 'cylinder':
            q = np.column_stack([np.hypot(p[:, 0], p[:, 1]) - half[0], np.abs(p[:, 2]) - half[2]])
        else:
            all_of_them.append(np.linalg.norm(p, axis=1) - half[0])
            continue
        all_of_them.append(np.linalg.norm(np.maximum(q, 0.0), axis=1)
                           + np.minimum(q.max(axis=1), 0.0))
    return np.min(all_of_them, axis=0)


def seen(tracked):
    """What a planner takes from the scene of its tracker."""
    kinds = {0: 'sphere', 1: 'box', 2: 'cylinder'}
    return [(kinds[int(shape)], half, pin.SE3(rotation, center))
            for shape, half, rotation, center in zip(
                tracked.shapes, tracked.half_extents, tracked.rotations, tracked.centers)]


def published(scene, around=AROUND):
    """The obstacles, and what is held in the hand's frame, as a planner reads them."""
    markers = scene_markers(scene, PANDA, around)
    results = []
    for marked, frame_id in ((markers.obstacles, BASE), (markers.held.get(HAND, ()), HAND)):
        tracker = ObstacleTracker((), (frame_id,))
        assert not tracker.update(bytes(serialize_message(MarkerArray(
            markers=[marker_message(frame_id, marker) for marker in marked]))), 0.0)
        results.append(tracker.scene)
    return (*results, markers.remarks)


class Twin:
    """The same scene kept by other means: SE3 and lists of shapes."""

    def __init__(self):
        self.world, self.hand = {}, {}

    def shapes(self, where, things):
        return [shape for name, (at, solids) in things.items()
                for kind, half, inner in solids for shape in [(kind, half, where * at * inner)]]


def pose_message(placement, rng):
    """A pose; its quaternion may be of any length, as MoveIt normalises."""
    numbers = pin.SE3ToXYZQUAT(placement)
    return m.pose(numbers[:3].tolist(), (numbers[3:] * rng.uniform(0.5, 2.0)).tolist())


def random_shapes(rng):
    """Lists for a CollisionObject, and (kind, half size, SE3 in the object) of each."""
    lists = {'primitives': [], 'primitive_poses': [], 'meshes': [], 'mesh_poses': []}
    solids = []
    bare = rng.random() < 0.25
    # Of the lists, primitives come first.
    for kind in sorted(rng.choice(['box', 'cylinder', 'sphere', 'cone', 'x mesh'],
                                  rng.integers(1, 4)).tolist(), key=lambda k: k == 'x mesh'):
        size = rng.uniform(0.02, 0.4, 3)
        inner = pin.SE3.Identity() if bare else random_pose(rng)
        if kind == 'x mesh':
            # A box somewhere in its frame, not along its axes.
            own = random_pose(rng)
            size = np.array([0.1, 0.5, 1.0]) * size.max()
            corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, 8).T * size
            lists['meshes'].append(m.mesh([own.act(corner) for corner in corners]))
            lists['mesh_poses'] += [] if bare else [pose_message(inner, rng)]
            solids.append(('box', 0.5 * size, inner * own))
            continue
        number, dimensions, half = {
            'box': (m.BOX, size, 0.5 * size),
            'sphere': (m.SPHERE, size[:1], np.full(3, size[0])),
            'cylinder': (m.CYLINDER, size[:2], np.array([size[1], size[1], 0.5 * size[0]])),
            'cone': (m.CONE, size[:2], np.array([size[1], size[1], 0.5 * size[0]]))}[kind]
        lists['primitives'].append(m.primitive(number, *dimensions.tolist()))
        lists['primitive_poses'] += [] if bare else [pose_message(inner, rng)]
        solids.append(('cylinder' if kind == 'cone' else kind, half, inner))
    return lists, solids


def step(rng, twin):
    """A random change: its message, once the twin has made it itself."""
    what = rng.choice(['add', 'append', 'move', 'remove', 'attach', 'attach there', 'detach',
                       'whole'], p=[0.3, 0.14, 0.14, 0.07, 0.1, 0.1, 0.12, 0.03])
    name = str(rng.choice(list('abcdefg')))
    frame_id = str(rng.choice(list(FRAMES)))
    at = random_pose(rng)
    lists, solids = random_shapes(rng)
    message = pose_message(at, rng)
    there = FRAMES[frame_id] * at
    diff = rng.random() < 0.5
    if what == 'add' or (what == 'append' and name not in twin.world):
        twin.world[name] = there, solids
        made = m.thing(name, m.ADD if what == 'add' else m.APPEND, message, frame_id, **lists)
    elif what == 'append':
        pose, before = twin.world[name]
        twin.world[name] = pose, before + solids
        made = m.thing(name, m.APPEND, message, frame_id, **lists)
    elif what == 'move' and name in twin.world:
        twin.world[name] = there, twin.world[name][1]
        made = m.thing(name, m.MOVE, message, frame_id)
    elif what == 'remove' and name in twin.world:
        del twin.world[name]
        made = m.thing(name, m.REMOVE)
    elif what == 'attach':
        twin.world.pop(name, None)
        twin.hand[name] = FRAMES[HAND].inverse() * there, solids
        held = m.attached(HAND, m.thing(name, m.ADD, message, frame_id, **lists))
        return m.scene(held=[held]) if diff else held
    elif what == 'attach there' and name in twin.world:
        pose, before = twin.world.pop(name)
        twin.hand[name] = FRAMES[HAND].inverse() * pose, before
        held = m.attached(HAND, m.thing(name))
        return m.scene(held=[held]) if diff else held
    elif what == 'detach' and name in twin.hand:
        pose, before = twin.hand.pop(name)
        twin.world.setdefault(name, (FRAMES[HAND] * pose, before))
        held = m.attached('', m.thing(name, m.REMOVE))
        return m.scene(held=[held]) if diff else held
    elif what == 'whole':
        twin.world, twin.hand = {name: (there, solids)}, {}
        return m.scene([m.thing(name, m.ADD, message, frame_id, **lists)], is_diff=False,
                       state_is_diff=False)
    else:
        return step(rng, twin)
    return m.scene([made]) if diff else made


@pytest.mark.first_alone
@pytest.mark.parametrize('seed', range(5))
def test_200_random_messages_leave_every_shape_where_it_belongs(seed):
    """Distances of 100 points to the markers' shapes and to the scene's agree within 1e-9 m."""
    rng, scene, twin = np.random.default_rng(seed), PlanningScene(), Twin()
    attached = 0
    for _ in range(200):
        scene, said = after(step(rng, twin), begin=scene)
        assert not [s for s in said if 'counts as' not in s and 'stays' not in s], said
        points = rng.uniform(-1.5, 1.5, (100, 3))
        obstacles, held, _ = published(scene)
        for tracked, things in ((obstacles, twin.world), (held, twin.hand)):
            expected = twin.shapes(pin.SE3.Identity(), things)
            assert len(tracked.names) == len(expected)
            if expected:
                difference = distances(seen(tracked), points) - distances(expected, points)
                assert np.abs(difference).max() < 1e-9
        attached += len(twin.hand)
    assert attached > 50


def where(tracked, name):
    """The places of an object's shapes."""
    return tracked.centers[[i for i, n in enumerate(tracked.names) if n.split('/')[0] == name]]


CUBE = m.primitive(m.BOX, 0.1, 0.2, 0.3)
AWAY = m.pose((0.5, 0.0, 0.4))


@pytest.mark.parametrize('poses', [[m.pose()], []])
def test_an_object_is_at_its_own_pose_where_its_shape_says_nothing(poses):
    """Case 13, the first two."""
    scene, said = after(m.scene([m.thing(
        'box', at=AWAY, frame=BASE, primitives=[CUBE], primitive_poses=poses)]))
    obstacles, _, _ = published(scene)
    assert not said and obstacles.names == ('box/0',)
    assert np.allclose(obstacles.centers, [[0.5, 0.0, 0.4]], atol=1e-12)
    assert np.allclose(obstacles.half_extents, [[0.05, 0.1, 0.15]])


def test_a_shape_alone_says_where_the_object_is_and_move_replaces_that():
    """As older senders of MoveIt do it, whose objects have no pose."""
    add = m.thing('box', primitives=[CUBE], primitive_poses=[AWAY])
    scene, _ = after(add, m.thing('box', m.MOVE, m.pose((0.1, 0.2, 0.3))))
    assert np.allclose(published(scene)[0].centers, [[0.1, 0.2, 0.3]], atol=1e-12)


def test_move_may_say_where_the_shapes_are():
    add = m.thing('box', at=AWAY, primitives=[CUBE, CUBE])
    move = m.thing('box', m.MOVE, m.pose((1.0, 0.0, 0.0)),
                   primitive_poses=[m.pose((0.0, 0.1, 0.0)), m.pose((0.0, 0.2, 0.0))])
    scene, said = after(add, move)
    assert not said
    assert np.allclose(where(published(scene)[0], 'box'), [[1.0, 0.1, 0.0], [1.0, 0.2, 0.0]])
    _, said = after(add, m.thing('box', m.MOVE, primitive_poses=[m.pose()]))
    assert said == ["object 'box' is given 1 poses of shapes, and it has 2; ignored"]


def test_a_mesh_is_the_box_around_it():
    """Case 13; a wedge, and one that is flat."""
    wedge = m.mesh([(0, 0, 0), (0.4, 0, 0), (0, 0.2, 0), (0, 0, 0.1)])
    flat = m.mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    scene, said = after(m.thing('wedge', at=AWAY, meshes=[wedge, flat]))
    obstacles, _, _ = published(scene)
    assert said[0] == "object 'wedge', mesh 0 is a mesh: it counts as the box around it"
    assert np.allclose(obstacles.centers[0], [0.7, 0.1, 0.45])
    assert np.allclose(obstacles.half_extents[0], [0.2, 0.1, 0.05])
    assert np.allclose(obstacles.half_extents[1, 2], 5e-6)


def test_a_cone_is_the_cylinder_around_it_and_that_is_said():
    """Case 13."""
    scene, said = after(m.thing('cone', at=AWAY, primitives=[m.primitive(m.CONE, 0.4, 0.1)]))
    obstacles, _, _ = published(scene)
    assert said == ["object 'cone', primitive 0 is a cone: it counts as the cylinder around it"]
    assert np.allclose(obstacles.half_extents, [[0.1, 0.1, 0.2]])
    assert seen(obstacles)[0][0] == 'cylinder'


def test_a_prism_is_the_box_around_it():
    prism = m.primitive(m.PRISM, 0.4, corners=[(0, 0), (0.2, 0), (0, 0.1)])
    scene, said = after(m.thing('prism', at=AWAY, primitives=[prism]))
    obstacles, _, _ = published(scene)
    assert 'box around it' in said[0]
    assert np.allclose(obstacles.centers, [[0.6, 0.05, 0.4]])
    assert np.allclose(obstacles.half_extents, [[0.1, 0.05, 0.2]])


@pytest.mark.parametrize('coefficients', [
    (0.0, 0.0, 2.0, 0.0), (0.0, 0.0, -1.0, 0.0), (0.3, -0.4, 0.5, 0.6), (1.0, 2.0, 0.1, -1.0)])
def test_a_plane_is_solid_behind_seen_from_the_arm(coefficients):
    """Case 13: points on the arm's side are as far from the slab as from the plane."""
    rng = np.random.default_rng(3)
    where_it_is = random_pose(rng)
    scene, said = after(m.thing('floor', at=pose_message(where_it_is, rng),
                                planes=[m.plane(*coefficients)]))
    obstacles, _, _ = published(scene)
    normal = np.array(coefficients[:3])
    local = where_it_is.inverse()
    points = rng.uniform(-3.0, 3.0, (500, 3))

    def height(point):
        return (local.act(point) @ normal + coefficients[3]) / np.linalg.norm(normal)

    heights = np.array([height(point) for point in points]) * np.sign(height(CENTER))
    assert not said and 100 < (heights > 0.0).sum() < 500
    assert np.abs(distances(seen(obstacles), points) - heights).max() < 1e-9


def test_removed_objects_are_gone():
    """Case 13: one of them, then all."""
    objects = [m.thing(name, primitives=[CUBE], at=AWAY) for name in 'abc']
    scene, said = after(*objects, m.thing('b', m.REMOVE))
    assert not said and set(scene.objects) == {'a', 'c'}
    _, said = after(m.thing('b', m.REMOVE), begin=scene)
    assert said == ["object 'b' is to be removed, and the scene has no such object; ignored"]
    scene, said = after(m.thing('', m.REMOVE), begin=scene)
    assert not said and not scene.objects


def test_what_is_attached_moves_from_the_world_into_the_hand_and_back():
    """Case 13: without a shape of its own it has that of the world."""
    held = m.attached(HAND, m.thing('cup'), touch_links=['panda_leftfinger'])
    scene, said = after(m.thing('cup', at=AWAY, primitives=[CUBE]), held)
    obstacles, in_hand, _ = published(scene)
    assert not said and obstacles.names == () and in_hand.names == ('cup/0',)
    expected = FRAMES[HAND].inverse().act(np.array([0.5, 0.0, 0.4]))
    assert np.allclose(in_hand.centers, [expected], atol=1e-12)
    # Again, as move_group does with each state: nothing changes.
    again, said = after(held, begin=scene)
    assert not said and again is scene
    scene, said = after(m.attached('panda_link7', m.thing('cup', m.REMOVE)), begin=scene)
    assert said == ["object 'cup' is to be detached from 'panda_link7', and it is attached to "
                    "'panda_hand'; ignored"]
    scene, said = after(m.attached('', m.thing('', m.REMOVE)), begin=scene)
    obstacles, in_hand, _ = published(scene)
    assert not said and in_hand.names == ()
    assert np.allclose(obstacles.centers, [[0.5, 0.0, 0.4]], atol=1e-12)


def test_an_object_in_the_frame_of_its_link_needs_no_other_frame():
    """As move_group publishes it: no joint_states are needed."""
    held = m.attached('panda_link8', m.thing('cup', at=AWAY, frame='panda_link8',
                                             primitives=[CUBE]))
    scene, said = after(m.scene(held=[held]))
    marked = scene_markers(scene, PANDA, AROUND)
    assert not said and not marked.remarks
    again, said = after(m.scene(held=[held]), begin=scene)
    assert not said and again is scene
    assert [len(marked.held[link]) for link in marked.held] == [1]
    assert np.allclose(marked.held['panda_link8'][0].pose[:3, 3], [0.5, 0.0, 0.4])


def test_what_is_attached_elsewhere_is_an_obstacle_or_named():
    """On a link at rest it is one; on a link that moves, the planner has no means."""
    scene, said = after(
        m.attached(BASE, m.thing('plate', at=AWAY, frame=BASE, primitives=[CUBE])),
        m.attached('panda_link4', m.thing('camera', at=AWAY, frame='panda_link4',
                                          primitives=[CUBE])),
        m.attached(HAND, m.thing('wall', frame=HAND, planes=[m.plane(0, 0, 1, 0)])))
    obstacles, in_hand, remarks = published(scene)
    assert not said and obstacles.names == ('plate/0',) and in_hand.names == ()
    assert len(remarks) == 2
    assert "object 'camera' is attached to 'panda_link4', which does not move along" in remarks[0]
    assert "object 'wall' is held and has a plane" in remarks[1]


def test_a_whole_scene_replaces_all_and_a_diff_leaves_the_rest():
    table = m.thing('table', at=AWAY, primitives=[CUBE])
    cup = m.attached(HAND, m.thing('cup', frame=HAND, primitives=[CUBE]))
    scene, _ = after(m.scene([table], held=[cup], is_diff=False, joints=['panda_joint1'],
                             contacts=m.matrix(['cup', 'table'], [('cup', 'table')])))
    diff, _ = after(m.scene([m.thing('chair', at=AWAY, primitives=[CUBE])]), begin=scene)
    assert set(diff.objects) == {'table', 'chair'} and set(diff.held) == {'cup'}
    assert diff.matrix is scene.matrix
    # A state that is no diff has let go of all that it does not list, if it has joints at all.
    for joints, left in (([], {'cup'}), (['panda_joint1'], set())):
        empty, _ = after(m.scene(state_is_diff=False, joints=joints), begin=scene)
        assert set(empty.held) == left
    whole, _ = after(m.scene(is_diff=False), begin=diff)
    assert not whole.objects and not whole.held and not whole.matrix.places


def test_objects_and_the_scenes_own_frames_are_frames_too():
    shelf = m.thing('shelf', at=AWAY, primitives=[CUBE])
    cup = m.thing('cup', at=m.pose((0.0, 0.0, 0.1)), frame='shelf', primitives=[CUBE])
    moved = m.Message(child_frame_id='world', header=m.Message(frame_id=BASE), transform=m.Message(
        translation=m.point(0.0, 1.0, 0.0), rotation=m.pose().orientation))
    ball = m.thing('ball', at=AWAY, frame='/world', primitives=[m.primitive(m.SPHERE, 0.1)])
    scene, said = after(shelf, cup, m.scene([ball], frames=[moved]))
    obstacles, _, _ = published(scene)
    assert not said
    assert np.allclose(where(obstacles, 'cup'), [[0.5, 0.0, 0.5]])
    assert np.allclose(where(obstacles, 'ball'), [[0.5, 1.0, 0.4]])
    _, said = after(m.thing('spoon', frame='shelf/top', primitives=[CUBE]), begin=scene)
    assert said == ["object 'spoon' is given in 'shelf/top', a subframe of 'shelf': subframes are "
                    'not read; ignored']
    _, said = after(m.thing('spoon', frame='moon', primitives=[CUBE]), begin=scene)
    assert said == ["object 'spoon' is given in frame 'moon': nobody knows moon; ignored"]


OCTREE = b'\0\xc0' + b'\3\0' * 14 + b'\2\0'  # sixteen levels down to one cube


def test_an_octomap_replaces_the_last_one_and_one_that_is_of_no_use_does_not():
    turned = m.pose((0.5, 0.0, 0.2), (0.0, 0.0, 1.0, 1.0))
    scene, said = after(m.scene(voxels=m.octomap(OCTREE, 0.1, origin=turned)))
    marked = scene_markers(scene, PANDA, AROUND)
    assert not said and np.allclose(marked.cubes[0.1], [[0.05, 0.05, 0.05]])
    assert np.allclose(scene.voxels.pose @ [0.05, 0.05, 0.05, 1.0], [0.45, 0.05, 0.25, 1.0])
    for bad in (m.octomap(OCTREE[:9], 0.1), m.octomap(OCTREE, name='ColorOcTree'),
                m.octomap(OCTREE, 0.1, frame='moon')):
        kept, said = after(m.scene(voxels=bad), begin=scene)
        assert kept is scene and len(said) == 1 and said[0].startswith('octomap ignored: ')
    # A change says nothing of it, and one that clears it has a name and no bytes.
    assert after(m.scene(), begin=scene)[0] is scene
    for clears in (m.scene(voxels=m.octomap(name='cleared')), m.scene(is_diff=False)):
        assert after(clears, begin=scene)[0].voxels is None


def test_of_too_many_cubes_the_nearest_to_the_arm_count(monkeypatch):
    monkeypatch.setattr(scene_markers_module, 'MOST_CUBES', 3)
    full = b'\0\0\0\0'

    def node(depth):
        return full + (b'\xff' + 8 * node(depth - 1) if depth else b'\0')

    scene, _ = after(m.scene(voxels=m.octomap(node(2), 1e-4, binary=False)))
    marked = scene_markers(scene, PANDA, AROUND)
    assert len(scene.voxels.cubes.edges) > 3
    away = np.linalg.norm(scene.voxels.cubes.centers - CENTER, axis=1)
    nearest = np.concatenate([*marked.cubes.values()])
    assert np.allclose(sorted(np.linalg.norm(nearest - CENTER, axis=1)), sorted(away)[:3])
    assert 'the 3 nearest to the arm count' in marked.remarks[0]


def test_zero_quaternions_are_none_and_others_are_normalised():
    """As MoveIt has it."""
    for quaternion in ((0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1e-300), (0.0, 0.0, 0.0, -7.0)):
        scene, said = after(m.thing('box', at=m.pose((0.5, 0.0, 0.4), quaternion),
                                    primitives=[CUBE]))
        assert not said
        assert np.allclose(published(scene)[0].rotations, [np.eye(3)])


@pytest.mark.parametrize(('message', 'reason'), [
    (m.thing('x', at=m.pose((np.nan, 0.0, 0.0)), primitives=[CUBE]), 'has the pose [nan, 0.0'),
    (m.thing('x', at=m.pose((1e9, 0.0, 0.0)), primitives=[CUBE]), 'up to 1e+06'),
    (m.thing('x'), 'has no shape that can be used'),
    (m.thing('x', primitives=[m.primitive(9, 0.1)]), 'primitive 0 has the type 9; it must be box'),
    (m.thing('x', primitives=[m.primitive(m.BOX, 0.1, 0.1)]), 'dimensions [0.1, 0.1]; it takes 3'),
    (m.thing('x', primitives=[m.primitive(m.SPHERE, -0.1)]), 'they must be from 1e-06'),
    (m.thing('x', primitives=[m.primitive(m.SPHERE, np.nan)]), 'they must be from 1e-06'),
    (m.thing('x', primitives=[CUBE], primitive_poses=[m.pose(), m.pose()]), 'has 2 poses of'),
    (m.thing('x', meshes=[m.mesh([])]), 'is a mesh without vertices'),
    (m.thing('x', meshes=[m.mesh([(0.0, np.inf, 0.0)])]), 'is a mesh with a vertex at [0.0, inf'),
    (m.thing('x', meshes=[m.Message(vertices=range(2_000_000))]), 'is a mesh of 2000000 vertices'),
    (m.thing('x', planes=[m.plane(0, 0, 0, 1)]), 'not all of a b c zero'),
    (m.thing('x', planes=[m.plane(1, 0, 0)]), 'it takes a b c d'),
    (m.thing('x', 7), 'has the operation 7; it must be ADD (0), REMOVE (1), APPEND (2), MOVE (3)'),
    (m.thing('x', m.MOVE), 'is to be moved, and the scene has no such object'),
    (m.thing('<octomap>', primitives=[CUBE]), 'which no object may have'),
    (m.thing('x' * 300, primitives=[CUBE]), 'has a name of 300 bytes'),
    (m.thing('x', primitives=[CUBE], subframe_names=['tip']), 'has subframes: they are not read'),
    (m.attached(HAND, m.thing('x')), 'without a shape, and the scene has no such object'),
    (m.attached(HAND, m.thing('x', m.REMOVE)), 'no such object is attached'),
    (m.attached(HAND, m.thing('x', m.MOVE)), 'there is no such MOVE'),
    (m.scene(contacts=m.Message(entry_names=['a'], entry_values=[], default_entry_names=[],
                                default_entry_values=[])), 'as many rows as names'),
    (m.scene(voxels=m.octomap(b'12', name='ColorOcTree')), "it must be 'OcTree'"),
    (m.scene(voxels=m.octomap(b'1')), 'end within a node'),
    (m.scene(voxels=m.octomap(b'12', resolution=0.0)), 'has a resolution of 0.0 m'),
])
def test_what_cannot_be_understood_is_named(message, reason):
    before, _ = after(m.thing('table', at=AWAY, primitives=[CUBE]))
    scene, said = after(message, begin=before)
    assert any(reason in sentence for sentence in said), said
    assert 'table' in scene.objects


def test_shapes_beyond_all_bounds_are_named():
    """Each pose is within them, and both together are not."""
    far = m.pose((9e5, 0.0, 0.0))
    scene, said = after(m.thing('x', at=far, primitives=[CUBE, CUBE], primitive_poses=[far, AWAY]))
    obstacles, _, remarks = published(scene)
    assert not said and obstacles.names == ('x/1',)
    assert remarks == ("object 'x' has a shape at [1800000.0, 0.0, 0.0]: up to 1e+06 m are taken",)


def test_of_an_object_the_good_shapes_count():
    scene, said = after(m.thing('x', at=AWAY, primitives=[m.primitive(9), CUBE]))
    assert published(scene)[0].names == ('x/0',) and 'it is left out' in said[0]


NUMBERS = st.one_of(st.floats(), st.sampled_from([0.0, 1.0, -1.0, 0.3, 9e5, 1e-320, 1e300]))
POSES = st.builds(m.pose, st.tuples(*[NUMBERS] * 3), st.tuples(*[NUMBERS] * 4))
NAMES = st.sampled_from(['', 'a', 'a/b', '<octomap>', 'a' * 300, 'ä\0', '\ud800', HAND])
LINKS = st.sampled_from(['', HAND, BASE, '/camera', 'moon', 'a', 'panda_link4'])
SOLIDS = st.builds(
    lambda kind, sizes, corners: m.primitive(kind, *sizes, corners=corners),
    st.integers(0, 6), st.lists(NUMBERS, max_size=4),
    st.lists(st.tuples(NUMBERS, NUMBERS), max_size=3))
MESHES = st.builds(m.mesh, st.lists(st.tuples(*[NUMBERS] * 3), max_size=5))
PLANES = st.builds(lambda numbers: m.plane(*numbers), st.lists(NUMBERS, min_size=3, max_size=5))
THINGS = st.builds(
    m.thing, NAMES, st.integers(0, 4), POSES, LINKS, primitives=st.lists(SOLIDS, max_size=2),
    primitive_poses=st.lists(POSES, max_size=3), meshes=st.lists(MESHES, max_size=1),
    mesh_poses=st.lists(POSES, max_size=1), planes=st.lists(PLANES, max_size=1),
    plane_poses=st.lists(POSES, max_size=1))
HELD = st.builds(m.attached, LINKS, THINGS, st.lists(LINKS, max_size=2))
OCTOMAPS = st.builds(m.octomap, st.binary(max_size=40), NUMBERS, st.booleans(),
                     st.sampled_from(['', 'OcTree', 'ColorOcTree']), POSES, LINKS)
SCENES = st.builds(
    m.scene, st.lists(THINGS, max_size=3), st.lists(HELD, max_size=2), st.booleans(),
    st.booleans(), st.lists(NAMES, max_size=1), st.builds(
        m.matrix, st.lists(NAMES, max_size=3), st.lists(st.tuples(NAMES, NAMES), max_size=3),
        st.lists(st.tuples(NAMES, st.booleans()), max_size=2)), OCTOMAPS)


@settings(max_examples=examples(100), deadline=None)
@given(st.lists(st.one_of(THINGS, HELD, SCENES), min_size=1, max_size=6))
def test_no_message_makes_an_exception_and_all_markers_can_be_used(messages):
    """Whatever comes: sentences, and markers that a planner takes as they are."""
    scene, said = after(*messages)
    assert all(isinstance(sentence, str) for sentence in said)
    names = {*scene.objects, *scene.held}
    for obstacle in published(scene)[0].names:
        assert obstacle.rpartition('/')[0] in names or obstacle.isdecimal()
    contacts = allowed_contacts(scene.matrix, obstacle_ids(scene, PANDA), scene.held, PANDA)
    AllowedContacts(contacts.entries, PANDA)
