"""A URDF's links and joints, with every name and number checked.

Pinocchio's own reader drops what it cannot read, or takes a default for it. It is given a URDF
that is written anew from what was checked here.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple
import xml.etree.ElementTree as ElementTree

from redundant_planner.core.errors import known, RobotError

MOVABLE = ('revolute', 'continuous', 'prismatic')
_KINDS = (*MOVABLE, 'fixed', 'floating', 'planar')
# What Pinocchio is told. A continuous joint would have two coordinates there (cos, sin), and here
# every posture is a plain vector. Floating and planar joints stand where they are.
_KIND_THERE = {'continuous': 'revolute', 'floating': 'fixed', 'planar': 'fixed'}
# Stands for no limit there [rad, m].
_UNLIMITED = 1e9

# Longer texts and names, and more links than this, are no arm's.
_LONGEST_TEXT = 20_000_000
_LONGEST_NAME = 200
_MOST_LINKS = 1000
# Neither lengths [m] nor angles [rad] are larger than this.
LARGEST = 1e4
# An axis that is shorter has no direction.
_SHORTEST_AXIS = 1e-6

Numbers = tuple[float, ...]
_ZERO = (0.0, 0.0, 0.0)
_X = (1.0, 0.0, 0.0)


class Mimic(NamedTuple):
    """A joint that stands at multiplier × another one's position + offset."""

    leader: str
    multiplier: float
    offset: float


class Joint(NamedTuple):
    """A joint, with what its type needs.

    Attributes:
        name: its name.
        kind: revolute, continuous, prismatic, fixed, floating or planar.
        parent, child: the links that it connects.
        xyz, rpy: (3,) the child in the parent's frame [m, rad].
        axis: (3,) of the motion, in the child's frame.
        lower, upper: limits [rad, m], infinite for continuous joints.
        velocity: limit [rad/s, m/s], 0 where the URDF has none.
        acceleration: limit [rad/s², m/s²] of speeding up and of slowing down, the smaller one; 0
            where the URDF has neither.
        jerk: limit [rad/s³, m/s³], may be infinite; 0 where the URDF has none.
        mimic: what it follows, if it does.
    """

    name: str
    kind: str
    parent: str
    child: str
    xyz: Numbers
    rpy: Numbers
    axis: Numbers
    lower: float
    upper: float
    velocity: float
    acceleration: float
    jerk: float
    mimic: Mimic | None


@dataclass(frozen=True)
class Urdf:
    """The tree of links and joints that a URDF describes.

    Attributes:
        name: the robot's name.
        links: name → element, as written.
        joints: as written.
        root: the link that hangs from no joint.
    """

    name: str
    links: dict[str, ElementTree.Element]
    joints: tuple[Joint, ...]
    root: str

    def joints_above(self, link: str) -> list[Joint]:
        """Return the joints from the root to a link, the root's first."""
        above = {joint.child: joint for joint in self.joints}
        path = []
        while link in above:
            path.append(above[link])
            link = above[link].parent
        return path[::-1]

    def rigid_with(self, link: str) -> list[str]:
        """Return the links that only fixed joints lie between and this one, which comes first."""
        neighbours: dict[str, list[str]] = {}
        for joint in self.joints:
            if joint.kind == 'fixed':
                neighbours.setdefault(joint.parent, []).append(joint.child)
                neighbours.setdefault(joint.child, []).append(joint.parent)
        found = {link: None}
        ahead = [link]
        while ahead:
            ahead = [other for near in ahead for other in neighbours.get(near, ())
                     if other not in found]
            found.update(dict.fromkeys(ahead))
        return list(found)

    def for_pinocchio(self) -> str:
        """Return the kinematics as a URDF for Pinocchio: one coordinate per movable joint."""
        robot = ElementTree.Element('robot', name=self.name)
        for link in self.links:
            ElementTree.SubElement(robot, 'link', name=link)
        for joint in self.joints:
            kind = _KIND_THERE.get(joint.kind, joint.kind)
            # Pinocchio mixes a fixed joint up with a link of the same name.
            name = f'{joint.name} (joint)' if (
                kind == 'fixed' and joint.name in self.links) else joint.name
            element = ElementTree.SubElement(robot, 'joint', name=name, type=kind)
            ElementTree.SubElement(element, 'parent', link=joint.parent)
            ElementTree.SubElement(element, 'child', link=joint.child)
            ElementTree.SubElement(
                element, 'origin', xyz=_written(joint.xyz), rpy=_written(joint.rpy))
            if kind != 'fixed':
                ElementTree.SubElement(element, 'axis', xyz=_written(joint.axis))
                ElementTree.SubElement(
                    element, 'limit', effort='0', velocity=repr(joint.velocity),
                    lower=repr(max(joint.lower, -_UNLIMITED)),
                    upper=repr(min(joint.upper, _UNLIMITED)))
        return ElementTree.tostring(robot, encoding='unicode')


def read_urdf(text: str) -> Urdf:
    """Read a URDF.

    Raises:
        RobotError: naming the link or joint that is wrong, and how.
    """
    if len(text) > _LONGEST_TEXT:
        raise RobotError(f'the URDF has {len(text)} characters; it may have {_LONGEST_TEXT}')
    try:
        robot = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise RobotError(f'the URDF is not well-formed XML: {error}') from None
    if robot.tag != 'robot':
        raise RobotError(f"the URDF's outermost element is <{robot.tag[:_LONGEST_NAME]}>; it "
                         'must be <robot>')
    links: dict[str, ElementTree.Element] = {}
    for element in robot.findall('link'):
        name = _name(element, 'link')
        if name in links:
            raise RobotError(f"the URDF has two links called '{name}'")
        links[name] = element
    if len(links) > _MOST_LINKS:
        raise RobotError(f'the URDF has {len(links)} links; it may have {_MOST_LINKS}')
    joints: dict[str, Joint] = {}
    for element in robot.findall('joint'):
        joint = _joint(element, links)
        if joint.name in joints:
            raise RobotError(f"the URDF has two joints called '{joint.name}'")
        joints[joint.name] = joint
    return Urdf(_name(robot, 'robot'), links, tuple(joints.values()),
                _root(links, tuple(joints.values())))


def numbers(
    element: ElementTree.Element | None, key: str, what: str, *, default: Numbers = (),
    count: int = 1, largest: float = LARGEST,
) -> Numbers:
    """Return the numbers of an attribute.

    Args:
        element: that has it, if there is one.
        key: the attribute.
        what: the element is, for the message.
        default: taken where there is no such attribute; empty if there must be one.
        count: how many it takes, where there is no default.
        largest: magnitude.

    Raises:
        RobotError: they are missing or not numbers, or one is too large.
    """
    text = None if element is None else element.get(key)
    if text is None and default:
        return default
    count = len(default) or count
    try:
        values = tuple(float(word) for word in (text or '').split())
    except ValueError:
        values = ()
    if len(values) != count or not all(abs(value) <= largest for value in values):
        found = f'lacks {key}' if text is None else f'has {key}={text[:60]!r}'
        wanted = 'a number' if count == 1 else f'{count} numbers'
        within = f' within ±{largest:g}' if math.isfinite(largest) else ''
        raise RobotError(f'{what} {found}; it takes {wanted}{within}')
    return values


def _joint(element: ElementTree.Element, links: dict[str, ElementTree.Element]) -> Joint:
    name = _name(element, 'joint')
    what = f"joint '{name}' of the URDF"
    kind = element.get('type', '')
    if kind not in _KINDS:
        raise RobotError(f"{what} has the type '{kind[:_LONGEST_NAME]}'; it must be one of "
                         f'{known(_KINDS)}')
    parent, child = (_end(element, end, links, what) for end in ('parent', 'child'))
    origin = element.find('origin')
    xyz = numbers(origin, 'xyz', f'the origin of {what}', default=_ZERO)
    rpy = numbers(origin, 'rpy', f'the origin of {what}', default=_ZERO)
    if kind not in MOVABLE:
        return Joint(name, kind, parent, child, xyz, rpy, _X, 0.0, 0.0, 0.0, 0.0, 0.0, None)
    axis = numbers(element.find('axis'), 'xyz', f'the axis of {what}', default=_X)
    if math.hypot(*axis) < _SHORTEST_AXIS:
        raise RobotError(f'{what} has the axis {_written(axis)}, which has no direction')
    limit = element.find('limit')
    lower, upper = _range(limit, kind, what)
    return Joint(name, kind, parent, child, xyz, rpy, axis, lower, upper,
                 *_rates(limit, f'the limit of {what}'), _mimic(element, what))


def _end(
    element: ElementTree.Element, end: str, links: dict[str, ElementTree.Element], what: str,
) -> str:
    """Return the link at one end of a joint."""
    found = element.find(end)
    link = '' if found is None else found.get('link', '')
    if link not in links:
        raise RobotError(f"{what} has the {end} '{link[:_LONGEST_NAME]}', which is not a link; "
                         f'the URDF has {known(links)}')
    return link


def _range(
    limit: ElementTree.Element | None, kind: str, what: str,
) -> tuple[float, float]:
    """Return the lower and upper limit."""
    if kind == 'continuous':
        return -math.inf, math.inf
    if limit is None:
        raise RobotError(f'{what} has no <limit>; only continuous joints need none')
    (lower,), (upper,) = (
        numbers(limit, key, f'the limit of {what}', default=(0.0,), largest=math.inf)
        for key in ('lower', 'upper'))
    if not -math.inf < lower <= upper < math.inf:
        raise RobotError(f'{what} has the limits {lower} and {upper}; lower must not exceed '
                         'upper, and both must be finite')
    return lower, upper


def _rates(limit: ElementTree.Element | None, what: str) -> tuple[float, float, float]:
    """Return the limits of velocity, acceleration and jerk, 0 for none.

    An infinite velocity or acceleration is none, as in version 1.2 of the format. A velocity of 0
    stands for none, too: exporters write it where they know none.
    """
    def rate(key: str, without: float, least: float) -> float:
        (value,) = numbers(limit, key, what, default=(without,), largest=math.inf)
        if not value >= least:
            raise RobotError(f'{what} has {key}={value}; it takes a positive number')
        return value

    tiny = math.ulp(0.0)
    velocity = rate('velocity', 0.0, 0.0)
    acceleration = min(rate('acceleration', math.inf, tiny), rate('deceleration', math.inf, tiny))
    jerk = 0.0 if limit is None or limit.get('jerk') is None else rate('jerk', 0.0, tiny)
    return (velocity if velocity < math.inf else 0.0,
            acceleration if acceleration < math.inf else 0.0, jerk)


def _mimic(element: ElementTree.Element, what: str) -> Mimic | None:
    mimic = element.find('mimic')
    if mimic is None:
        return None
    (multiplier,) = numbers(mimic, 'multiplier', f'the mimic of {what}', default=(1.0,))
    (offset,) = numbers(mimic, 'offset', f'the mimic of {what}', default=(0.0,))
    return Mimic(mimic.get('joint', ''), multiplier, offset)


def _name(element: ElementTree.Element, what: str) -> str:
    name = element.get('name', '')
    if not name.isprintable() or not 0 < len(name) <= _LONGEST_NAME:
        raise RobotError(f'a <{what}> of the URDF is called {name[:60]!r}; it takes a name of 1 '
                         f'to {_LONGEST_NAME} printable characters')
    return name


def _root(links: dict[str, ElementTree.Element], joints: tuple[Joint, ...]) -> str:
    """Return the only link that hangs from no joint, after making sure that all hang from it."""
    children: dict[str, list[str]] = {}
    hanging: dict[str, str] = {}
    for joint in joints:
        if joint.child in hanging:
            raise RobotError(f"link '{joint.child}' of the URDF hangs from two joints, "
                             f"'{hanging[joint.child]}' and '{joint.name}'")
        hanging[joint.child] = joint.name
        children.setdefault(joint.parent, []).append(joint.child)
    roots = [link for link in links if link not in hanging]
    if len(roots) > 1:
        raise RobotError('the URDF is not one tree of links: no joint holds '
                         f'{known(roots)}, and only the root may hang from none')
    reached, ahead = set(roots), roots
    while ahead:
        ahead = [child for link in ahead for child in children.get(link, ())]
        reached.update(ahead)
    circle = [link for link in links if link not in reached]
    if circle or not roots:
        raise RobotError('the URDF does not describe a robot: ' + (
            f'the joints of {known(circle)} form a circle' if circle else 'it has no links'))
    return roots[0]


def _written(values: Numbers) -> str:
    return ' '.join(map(repr, values))
