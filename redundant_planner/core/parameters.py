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
        group: first part of its name in ROS and in files: `clearance_margin` of the group
            `clearance` is called `clearance.margin` there.
        node: whether nodes declare it; the others are constants that experiments may vary.
    """

    unit: str = ''
    description: str = ''
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    runtime: bool = False
    size: int = 0
    group: str = ''
    node: bool = True


def parameter(default: Any, **spec: Any) -> Any:
    """Declare a dataclass field as a parameter; keyword arguments are those of `Spec`."""
    return field(default=default, metadata={'spec': Spec(**spec)})


def spec_of(entry: Field[Any]) -> Spec:
    """Return the Spec of a field made by `parameter`."""
    spec = entry.metadata['spec']
    assert isinstance(spec, Spec)
    return spec


def ros_name(entry: Field[Any]) -> str:
    """Return what ROS and parameter files call a field made by `parameter`."""
    group = spec_of(entry).group
    return f'{group}.{entry.name[len(group) + 1:]}' if group else entry.name


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
    spec, name = spec_of(entry), ros_name(entry)
    if not isinstance(entry.default, tuple):
        return _scalar(name, spec, type(entry.default), value)
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise ParameterError(f"parameter '{name}' is {shown(value)}; it must be a list")
    items = tuple(value)
    if spec.size and len(items) != spec.size:
        raise ParameterError(
            f"parameter '{name}' has {len(items)} entries; it takes {spec.size}")
    kind = str if 'str' in str(entry.type) else float
    return tuple(_scalar(name, spec, kind, item) for item in items)


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


def is_number(text: str) -> bool:
    """Return whether a text is a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


AXES = ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')
COMMAND_FRAMES = ('base', 'tool')
# The last two are the paper's to the letter, without limits or a safety filter.
METHODS = ('gradient_projection', 'dynamic_factor', 'variational')
PAPER_METHODS = ('paper', 'paper_gradient_projection')
TARGET_PATHS = ('free', 'straight')
# Largest speed of a commanded twist for which no limit is set, linear and angular [m/s, rad/s].
_TWIST_SPEEDS = (1.0, 2.0)
PATH_PRIORITIES = ('yield', 'strict', 'slide')


@dataclass(frozen=True)
class PlannerParameters:
    """The planner's parameters; constructing one checks every value.

    Raises:
        ParameterError: a value has the wrong type or range, or two do not go together.
    """

    method: str = parameter(
        'dynamic_factor', choices=METHODS + PAPER_METHODS, runtime=True,
        description='Null-space motion: by a fixed factor (gradient_projection), by Eq. 2 '
                    '(dynamic_factor), or along the shortest joint path (variational). The '
                    "paper's two keep no limit and no distance.")
    path_priority: str = parameter(
        'yield', choices=PATH_PRIORITIES, runtime=True,
        description='yield: the tip leaves its path if something moves into the arm. strict: '
                    'never, and it may be hit. slide: also along static obstacles, instead of '
                    'slowing down.')
    tip_order: tuple[str, ...] = parameter(
        (), runtime=True,
        description='Order in which several tips keep their speed if not all can: a share of one '
                    'is worth ten times that of the next. Tips without a place come last. Empty: '
                    'all alike.')
    criteria_k_alpha: float = parameter(
        0.9, low=0.0, high=10.0, runtime=True,
        group='criteria',
        description='Largest null-space speed of Eq. 2, as a share of the least-norm speed. '
                    'Larger gets past more obstacles, on longer joint paths.')
    criteria_k_fixed: float = parameter(
        2.1e-5, low=0.0, high=1e6, runtime=True,
        group='criteria',
        description='k of Eq. 1, for gradient_projection. Too large, and the arm oscillates; too '
                    'small, and it does not evade.')
    criteria_k_w: float = parameter(
        30.0, low=0.0, high=1e6, runtime=True,
        group='criteria',
        description='Weight of the clearance index H_w. Larger moves the arm away sooner; with 0 '
                    'only the filter minds obstacles.')
    criteria_k_s: float = parameter(
        0.0, low=0.0, high=1e6, runtime=True,
        group='criteria',
        description='Weight of the joint-limit index H_s. Larger keeps joints mid-range, on '
                    'longer joint paths.')
    criteria_k_f: float = parameter(
        1.0, low=0.0, high=1e6, runtime=True,
        group='criteria',
        description='Weight of the shortest-path index H_f.')
    criteria_k_m: float = parameter(
        10.0, low=0.0, high=1e6,
        group='criteria', node=False,
        description='Weight of the manipulability index near a singularity: 0 at twice '
                    'singularity.margin, all of it at the margin. With 0 the arm stops in front '
                    'of singularities that its null space could have gone around.')
    criteria_joint_weights: tuple[float, ...] = parameter(
        (), low=1e-6, high=1e6,
        group='criteria',
        description='Cost of moving each joint; empty for 1. Weigh metres against radians with '
                    'it.')
    posture_preferred: tuple[str, ...] = parameter(
        (), runtime=True,
        group='posture',
        description="Where joints should rather be, as 'joint=position'; ~/posture sets it, too.")
    posture_weight: float = parameter(
        1.0, low=0.0, high=1e6, unit='1/s²', runtime=True,
        group='posture',
        description='Weight of the distance from posture.preferred.')
    cone_angle: float = parameter(
        math.pi, low=1e-3, high=math.pi, unit='rad', runtime=True,
        group='cone',
        description='How far cone.tip_axis may lean away from cone.direction. Motion beyond is '
                    'slowed.')
    cone_tip_axis: tuple[float, ...] = parameter(
        (0.0, 0.0, 1.0), low=-1e6, high=1e6, size=3, runtime=True,
        group='cone',
        description='An axis of the tip, in its own frame.')
    cone_direction: tuple[float, ...] = parameter(
        (0.0, 0.0, 1.0), low=-1e6, high=1e6, size=3, runtime=True,
        group='cone',
        description='Where that axis should point, in the base frame.')
    clearance_margin: float = parameter(
        0.01, low=0.0, high=1.0, unit='m', runtime=True,
        group='clearance',
        description='Distance kept between links and obstacles.')
    clearance_influence_distance: float = parameter(
        0.1, low=1e-3, unit='m', runtime=True,
        group='clearance',
        description='Distance at which obstacles begin to act on the null space; infinite as in '
                    'Eq. 7.')
    clearance_smoothing: float = parameter(
        0.5, low=0.0, high=1e3, unit='S',
        group='clearance', node=False,
        description='Width over which the minimum of Eq. 7 is blended between pairs; 0 is the '
                    'hard minimum, whose gradient jumps when the nearest pair changes.')
    clearance_self_margin: float = parameter(
        0.005, low=-1.0, high=1.0, unit='m', runtime=True,
        group='clearance',
        description='Distance kept between links of the arm; -1 ignores self-collision. Too '
                    'large, and the arm cannot fold.')
    clearance_gain: float = parameter(
        5.0, low=0.1, high=1000.0, unit='1/s', runtime=True,
        group='clearance',
        description='Largest share of a clearance used up per second. Higher: faster near '
                    'obstacles, turning away later and harder.')
    clearance_lead: float = parameter(
        0.05, low=0.0, high=2.0, unit='s', runtime=True,
        group='clearance',
        description='Moving obstacles are kept further away by their way in this time. Too short, '
                    'and late measurements cost clearance.')
    clearance_evasion_horizon: float = parameter(
        2.0, low=0.0, high=10.0, unit='s',
        group='clearance', node=False,
        description="Constant-velocity prediction time for moving obstacles. Where an obstacle's "
                    'course leads into a link, the arm steps aside in time. 0 turns this off.')
    allowed_contacts: tuple[str, ...] = parameter(
        (), runtime=True,
        description="Contacts that are meant, as 'link:obstacle' or 'attached:obstacle'. Such a "
                    'pair keeps no margin, but overlaps no deeper.')
    slow_down: tuple[str, ...] = parameter(
        (), runtime=True,
        description="Obstacles near which the arm is slow, as 'name=distance:time': it keeps "
                    'below (d - distance) / time - v. Not safety-rated.')
    limits_position_margin: float = parameter(
        0.01, low=0.0, high=0.5, unit='rad, m', runtime=True,
        group='limits',
        description='Distance kept from the joint limits, for the travel between a measurement '
                    'and its command.')
    limits_linear_speed: float = parameter(
        math.inf, low=0.0, unit='m/s', runtime=True,
        group='limits',
        description='Largest speed of the tip; 0 stops every motion. Infinite: 1 m/s, but on free '
                    'ways that of the joints.')
    limits_angular_speed: float = parameter(
        math.inf, low=0.0, unit='rad/s', runtime=True,
        group='limits',
        description='Largest turning speed of the tip; 0 stops every turn. Infinite: 2 rad/s, but '
                    'on free ways that of the joints.')
    drive_lag: float = parameter(
        0.0, low=0.0, high=0.5, unit='s',
        group='drive',
        description="Time constant of the drives' velocity (identify_delay). Off by half, and the "
                    'tip is a millimetre further off its path.')
    drive_dead_time: float = parameter(
        0.0, low=0.0, high=0.5, unit='s',
        group='drive',
        description='Time from a command to the first measurement of its effect (identify_delay).')
    singularity_margin: float = parameter(
        0.04, low=0.0, high=10.0, unit='m', runtime=True,
        group='singularity',
        description='Smallest allowed singular value of J; 0 for none. Too small, and joints '
                    'race; too large, and the workspace shrinks.')
    singularity_damping_threshold: float = parameter(
        0.03, low=0.0, high=10.0, unit='m',
        group='singularity', node=False,
        description='Smallest singular value of J below which damping sets in; 0 never damps.')
    singularity_damping: float = parameter(
        0.05, low=0.0, high=10.0, unit='m',
        group='singularity', node=False,
        description='Damping of the least-norm solution in a singularity.')
    horizon_duration: float = parameter(
        3.0, low=0.05, high=30.0, unit='s', runtime=True,
        group='horizon',
        description='Length of the joint path ahead with a known command. Too short, and the arm '
                    'turns away late.')
    horizon_held_duration: float = parameter(
        1.0, low=0.05, high=30.0, unit='s',
        group='horizon', node=False,
        description='Length of the joint path ahead where only the present command is known, '
                    'which is then held. Too long, and it plans for commands that will not come.')
    horizon_nodes: int = parameter(
        12, low=2, high=32,
        group='horizon', node=False,
        description='Number of postures of the joint path ahead. Twice as many make a planning '
                    'tick four times as long; too few cut corners.')
    horizon_look_ahead: float = parameter(
        1.5, low=0.0, high=10.0, unit='s', runtime=True,
        group='horizon',
        description='How far dynamic_factor looks for obstacles and limits, to plan a joint path. '
                    'Longer gets past more, in slower ticks; 0 is Eq. 2 alone.')
    target_path: str = parameter(
        'free', choices=TARGET_PATHS, runtime=True,
        group='target',
        description='Way to a target_pose. free: around obstacles. straight: in a line; it stops '
                    'where that is blocked.')
    target_lag: float = parameter(
        0.08, low=0.0, high=2.0, unit='s', runtime=True, group='target',
        description='How far the arm is behind a stream of targets, to average noise and bridge '
                    'gaps. 0 is rougher.')
    target_effort: float = parameter(
        0.3, low=0.01, high=1.0, runtime=True, group='target',
        description='Share of each period for the search for a way, 1.2 ms at most, on the way '
                    '0.9. With less the arm sets off later, and goes longer ways.')
    target_margin: float = parameter(
        -1.0, low=-1.0, high=1.0, unit='m', runtime=True, group='target',
        description='Distance kept from obstacles on the way to a target, if that is less than '
                    'clearance.margin; with -1 that one counts. 0.002 for narrow places.')
    target_gives_way: bool = parameter(
        False, runtime=True, group='target',
        description='Whether the arm goes aside if it finds no free way for 3 s. Set it for all '
                    'arms but one.')
    feedback_gain: float = parameter(
        10.0, low=0.0, high=100.0, unit='1/s', runtime=True,
        group='feedback',
        description='Feedback of the tip pose error; 0 drifts, as the paper does. Above a tenth '
                    'of the rate it oscillates.')
    feedback_speed: float = parameter(
        0.1, low=0.0, high=100.0, unit='m/s',
        group='feedback', node=False,
        description='Largest speed of the feedback of a position error.')
    feedback_angular_speed: float = parameter(
        0.5, low=0.0, high=100.0, unit='rad/s',
        group='feedback', node=False,
        description='Largest speed of the feedback of an orientation error.')
    feedback_distance: float = parameter(
        0.3, low=0.0, high=100.0, unit='m',
        group='feedback', node=False,
        description='Larger position errors are forgotten: an arm pushed further away than this '
                    'does not come all the way back by itself.')
    feedback_angle: float = parameter(
        0.5, low=0.0, high=3.0, unit='rad',
        group='feedback', node=False,
        description='Larger orientation errors are forgotten.')

    @property
    def twist_speeds(self) -> tuple[float, float]:
        """Largest linear and angular speed of a commanded twist [m/s, rad/s]."""
        linear, angular = self.limits_linear_speed, self.limits_angular_speed
        return (linear if math.isfinite(linear) else _TWIST_SPEEDS[0],
                angular if math.isfinite(angular) else _TWIST_SPEEDS[1])

    def __post_init__(self) -> None:
        """Check every value and the relations between them."""
        check(self)
        for entry in self.posture_preferred:
            if not all(entry.partition('=')[::2]) or not is_number(entry.partition('=')[2]):
                raise ParameterError(
                    f"parameter 'posture.preferred' has {shown(entry)}; it takes "
                    "'joint=position', a joint's name and a number [rad, m]")
        for name in ('tip_axis', 'direction'):
            if not any(getattr(self, f'cone_{name}')):
                raise ParameterError(f"parameter 'cone.{name}' is a vector of zeros; it must "
                                     'point somewhere')
        for contact in self.allowed_contacts:
            if not all(contact.partition(':')[::2]):
                raise ParameterError(
                    f"parameter 'allowed_contacts' has {shown(contact)}; it takes "
                    "'link:obstacle', the names of a link and an obstacle")
        if self.singularity_damping_threshold > 0.0 and self.singularity_damping == 0.0:
            raise ParameterError(
                "parameter 'singularity.damping' is 0 while 'singularity.damping_threshold' is "
                f'{self.singularity_damping_threshold}; set both to 0 for none')
