"""Every number of the planner's mathematics: default, range, unit and what it does.

This is the only place a default is written. ROS declarations, descriptors, validation and the
parameter page of the docs are made from these fields.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, Field, field, fields
import math
from typing import Any, NamedTuple

from redundant_planner.core.errors import known, ParameterError, shown

# What ROS and YAML writers hold in 64 bits.
_LARGEST_INTEGER = 2**63


class Spec(NamedTuple):
    """What a parameter may be.

    Attributes:
        unit: physical unit, empty for none.
        description: a sentence; what goes wrong if the value is wrong.
        low, high: allowed range, both ends included.
        choices: allowed strings, empty for any.
        runtime: whether it may change while the node runs.
        size: required length of a list, 0 for any.
    """

    unit: str = ''
    description: str = ''
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    runtime: bool = False
    size: int = 0


def parameter(default: Any, **spec: Any) -> Any:
    """Declare a dataclass field as a parameter; keyword arguments are those of `Spec`."""
    return field(default=default, metadata={'spec': Spec(**spec)})


def spec_of(entry: Field[Any]) -> Spec:
    """Return the Spec of a field made by `parameter`."""
    spec = entry.metadata['spec']
    assert isinstance(spec, Spec)
    return spec


def check(parameters: Any) -> None:
    """Check every field of a parameter dataclass against its Spec.

    Integers given for floats and lists given for tuples are converted in place.

    Raises:
        ParameterError: naming the parameter, its value and what it may be.
    """
    for entry in fields(parameters):
        value = checked(entry, getattr(parameters, entry.name))
        object.__setattr__(parameters, entry.name, value)


def checked(entry: Field[Any], value: Any) -> Any:
    """Return `value` in the field's type.

    Raises:
        ParameterError: it does not fit; the message says what would.
    """
    spec = spec_of(entry)
    if not isinstance(entry.default, tuple):
        return _scalar(entry.name, spec, type(entry.default), value)
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise ParameterError(f"parameter '{entry.name}' is {shown(value)}; it must be a list")
    items = tuple(value)
    if spec.size and len(items) != spec.size:
        raise ParameterError(
            f"parameter '{entry.name}' has {len(items)} entries; it takes {spec.size}")
    kind = str if 'str' in str(entry.type) else float
    return tuple(_scalar(entry.name, spec, kind, item) for item in items)


def _scalar(name: str, spec: Spec, kind: type, value: Any) -> Any:
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and (
        isinstance(value, float) or abs(value) < _LARGEST_INTEGER)
    fits, wanted = {
        bool: (isinstance(value, bool), 'true or false'),
        int: (number and value == value // 1, 'a whole number'),
        float: (number and not math.isnan(value), 'a number'),
        str: (isinstance(value, str), 'a string'),
    }[kind]
    if not fits:
        raise ParameterError(f"parameter '{name}' is {shown(value)}; it must be {wanted}")
    value = kind(value)
    if kind in (int, float) and not spec.low <= value <= spec.high:
        raise ParameterError(f"parameter '{name}' is {value}; it must lie in "
                             f'[{spec.low:g}, {spec.high:g}] {spec.unit}'.rstrip())
    if spec.choices and value not in spec.choices:
        raise ParameterError(
            f"parameter '{name}' is {shown(value)}; it must be one of {known(spec.choices)}")
    return value


AXES = ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')
COMMAND_FRAMES = ('base', 'tool')
METHODS = ('gradient_projection', 'dynamic_factor', 'variational')
CLEARANCE_POINTS = ('links', 'joints')
PATH_PRIORITIES = ('yield', 'strict')


@dataclass(frozen=True)
class PlannerParameters:
    """The planner's parameters; constructing one checks every value.

    Raises:
        ParameterError: a value has the wrong type or range, or two do not go together.
    """

    method: str = parameter(
        'dynamic_factor', choices=METHODS, runtime=True,
        description='How the null-space motion is scaled: by a fixed factor '
                    '(gradient_projection, the traditional method), by Eq. 2 (dynamic_factor), '
                    'or so that the joint path over the horizon becomes the shortest '
                    '(variational).')
    k_fixed: float = parameter(
        2.1e-5, low=0.0, high=1e6, runtime=True,
        description='Factor k of Eq. 1 for gradient_projection. Too large and the arm oscillates '
                    'about the best posture, too small and it does not evade.')
    k_alpha: float = parameter(
        0.9, low=0.0, high=10.0, runtime=True,
        description='Adjustment coefficient of Eq. 2 for dynamic_factor: the largest null-space '
                    'speed as a share of the least-norm speed. More of it gets past more '
                    'obstacles, on longer joint paths.')
    k_w: float = parameter(
        30.0, low=0.0, high=1e6, runtime=True,
        description='Weight of the clearance index H_w in Eq. 18: the larger, the sooner the arm '
                    'moves away from obstacles as fast as k_alpha lets it. With 0 nothing but '
                    'the safety filter minds them.')
    k_s: float = parameter(
        0.0, low=0.0, high=1e6, runtime=True,
        description='Weight of the joint-limit index H_s in Eq. 18. Large values keep joints '
                    'mid-range at the price of longer joint paths.')
    k_f: float = parameter(
        1.0, low=0.0, high=1e6, runtime=True,
        description='Weight of the shortest-path index H_f in Eq. 18.')
    k_m: float = parameter(
        10.0, low=0.0, high=1e6, runtime=True,
        description='Weight of the manipulability index next to a singularity: nothing at twice '
                    'singularity_margin, all of it at the margin. With 0 the arm stops in front '
                    'of singularities that its null space could have gone around.')
    clearance_points: str = parameter(
        'links', choices=CLEARANCE_POINTS,
        description='What Eq. 7 is taken over: whole links, or the joints alone as the paper '
                    'does, which lets links pass through an obstacle.')
    clearance_smoothing: float = parameter(
        0.5, low=0.0, high=1e3, unit='S', runtime=True,
        description='Width over which the minimum of Eq. 7 is blended between pairs; 0 is the '
                    'hard minimum, whose gradient jumps when the nearest pair changes.')
    influence_distance: float = parameter(
        0.1, low=1e-3, unit='m', runtime=True,
        description='Distance at which an obstacle begins to act on the null space; infinite is '
                    'Eq. 7 to the letter, where the farthest obstacle pushes hardest.')
    damping: float = parameter(
        0.05, low=0.0, high=10.0, unit='m', runtime=True,
        description='Damping of the least-norm solution in a singularity.')
    damping_threshold: float = parameter(
        0.03, low=0.0, high=10.0, unit='m', runtime=True,
        description='Smallest singular value of J below which damping sets in; 0 never damps.')
    look_ahead: float = parameter(
        1.5, low=0.0, high=10.0, unit='s', runtime=True,
        description='dynamic_factor hands the null space over to the joint path that variational '
                    'plans where the commanded motion, gone on with for this time, leads into '
                    'an obstacle or a joint limit. Longer gets past more of them on shorter '
                    'joint paths, in slower ticks; 0 leaves it at Eq. 2.')
    horizon: float = parameter(
        3.0, low=0.05, high=30.0, unit='s', runtime=True,
        description='How far the joint path ahead reaches where it is known what will be '
                    'commanded. Too short and the arm turns away late.')
    horizon_held: float = parameter(
        1.0, low=0.05, high=30.0, unit='s', runtime=True,
        description='How far it reaches where the present command alone is known, which is then '
                    'taken as held. Too long and it is planned for what will not be '
                    'commanded.')
    horizon_nodes: int = parameter(
        12, low=2, high=32, runtime=True,
        description='Postures that the joint path ahead has. Twice as many take a tick that plans '
                    'four times as long; too few and it cuts corners.')
    joint_weights: tuple[float, ...] = parameter(
        (), low=1e-6, high=1e6,
        description='Cost of moving each joint, one value per joint, empty for 1 everywhere. '
                    'Makes metres and radians comparable: the result of a least norm depends on '
                    'the unit of a prismatic joint.')
    drift_gain: float = parameter(
        10.0, low=0.0, high=100.0, unit='1/s', runtime=True,
        description='Feedback of the tip pose error; 0 integrates open-loop, as the paper does, '
                    'and drifts. Above a tenth of the rate it oscillates.')
    drift_speed: float = parameter(
        0.1, low=0.0, high=100.0, unit='m/s', runtime=True,
        description='Largest speed at which a position error is taken back.')
    drift_angular_speed: float = parameter(
        0.5, low=0.0, high=100.0, unit='rad/s', runtime=True,
        description='Largest speed at which an orientation error is taken back.')
    drift_distance: float = parameter(
        0.3, low=0.0, high=100.0, unit='m', runtime=True,
        description='Larger position errors are forgotten: an arm that was held back or pushed '
                    'further away than this does not come all the way back by itself.')
    drift_angle: float = parameter(
        0.5, low=0.0, high=3.0, unit='rad', runtime=True,
        description='Larger orientation errors are forgotten, as drift_distance.')
    linear_speed_max: float = parameter(
        1.0, low=0.0, high=100.0, unit='m/s', runtime=True,
        description='A faster commanded twist is slowed to this, its direction kept; 0 stops '
                    'every motion.')
    angular_speed_max: float = parameter(
        2.0, low=0.0, high=100.0, unit='rad/s', runtime=True,
        description='A faster commanded rotation is slowed to this, the direction kept; 0 stops '
                    'every motion that turns.')
    safety_filter: bool = parameter(
        True,
        description='Enforce limits and clearance on every tick. Off only to reproduce the '
                    'paper: the arm then runs into limits and obstacles.')
    position_margin: float = parameter(
        0.01, low=0.0, high=0.5, unit='rad, m', runtime=True,
        description='Distance kept from the joint position limits; covers what the arm travels '
                    'between a measurement and the command made from it.')
    clearance_margin: float = parameter(
        0.01, low=0.0, high=1.0, unit='m', runtime=True,
        description='Distance kept between links and obstacles.')
    obstacle_lead: float = parameter(
        0.1, low=0.0, high=2.0, unit='s', runtime=True,
        description='What moves is kept further away, by the way that it makes in this time: '
                    'where it is may be known late, and the arm needs time to evade.')
    evasion_horizon: float = parameter(
        2.0, low=0.0, high=10.0, unit='s', runtime=True,
        description='For how long what moves is taken to go on as it does. Where that leads into '
                    'a link, the first two joints turn out of the way in time; 0 leaves it at '
                    'turning away from what is near.')
    self_collision_margin: float = parameter(
        0.005, low=-1.0, high=1.0, unit='m', runtime=True,
        description='Distance kept between links of the arm; -1 does not look at them. Too large, '
                    'and the arm cannot fold.')
    singularity_margin: float = parameter(
        0.04, low=0.0, high=10.0, unit='m', runtime=True,
        description='Smallest singular value of J that the arm may go down to; 0 for none. '
                    'Small values let joints race next to a singularity, large ones shrink the '
                    'workspace.')
    barrier_gain: float = parameter(
        5.0, low=0.1, high=1000.0, unit='1/s', runtime=True,
        description='How fast a remaining clearance may be used up: at most this share of it per '
                    'second, and never faster than the arm can brake. Higher values let it go '
                    'faster near obstacles and turn away later and harder.')
    path_priority: str = parameter(
        'yield', choices=PATH_PRIORITIES, runtime=True,
        description='Whether the tip may leave its path (yield) where something moves into the '
                    'arm, or was found too close to it, and nothing else helps; it comes back '
                    'afterwards. strict: never, it may be hit. Past what stands still the path '
                    'is kept either way.')

    def __post_init__(self) -> None:
        """Check every value and the relations between them."""
        check(self)
        if self.damping_threshold > 0.0 and self.damping == 0.0:
            raise ParameterError(
                "parameter 'damping' is 0 while 'damping_threshold' is "
                f'{self.damping_threshold}; set both to 0 for none, or damping above 0')
