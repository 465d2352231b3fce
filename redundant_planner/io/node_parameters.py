"""What each node needs besides the robot and the mathematics.

Not in nodes/, for tools without ROS read the same parameter files.
"""

from __future__ import annotations

from dataclasses import dataclass

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.obstacles.workspace import walls
from redundant_planner.core.parameters import check, parameter

JOINT_COMMAND = 'joint_command'
POSITION_COMMANDS = 'position_commands'
VELOCITY_COMMANDS = 'velocity_commands'
JOINT_TRAJECTORY = 'joint_trajectory'
OUTPUTS = (POSITION_COMMANDS, VELOCITY_COMMANDS, JOINT_TRAJECTORY)


@dataclass(frozen=True)
class PlannerNodeParameters:
    """What planner_node needs besides the robot and the mathematics.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    rate: int = parameter(
        250, low=1, high=1000, unit='Hz',
        description='Rate of joint_command. A slow rate makes every margin coarser.')
    incoming_command_timeout: float = parameter(
        0.1, low=0.005, high=10.0, unit='s', runtime=True,
        description='A cmd_vel older than this counts as zero. Long timeouts let the arm run on '
                    'after its operator has gone.')
    joint_state_timeout: float = parameter(
        0.1, low=0.005, high=10.0, unit='s', runtime=True,
        description='Without joint_states for this long the arm is stopped and nothing is '
                    'published until they are back.')
    follow_tolerance: float = parameter(
        0.02, low=0.0, high=1.0, unit='rad, m', runtime=True, group='follow',
        description='How far a joint may stay behind its commands, besides what drives and '
                    'measurements are late by. An arm that stays further behind, as its '
                    'controller is not active, is stopped, and moves again with the next fresh '
                    'command. 0 turns this off. Smaller, and a load or play in the gears stops '
                    'the arm.')
    enable_stamped_cmd_vel: bool = parameter(
        False, description='cmd_vel is TwistStamped instead of Twist: it says its frame (base or '
                           'tip) and when it was meant.')
    obstacle_topics: tuple[str, ...] = parameter(
        ('obstacles',),
        description='Topics with obstacles (MarkerArray), the names of markers for each on its '
                    'own. ~/body of another planner_node makes it an arm to keep clear of.')
    estimate_obstacle_velocity: bool = parameter(
        False, runtime=True,
        description='Obstacles seen at one place after another are taken to move on like that, '
                    'and are evaded earlier. Noisy detections make the arm flinch.')
    outputs: tuple[str, ...] = parameter(
        (), choices=OUTPUTS,
        description='Topics besides joint_command: position_commands or velocity_commands '
                    '(Float64MultiArray, for forward_command_controller), joint_trajectory (for '
                    'joint_trajectory_controller).')
    publish_ticks: bool = parameter(
        False, description='Whether every input of every tick is published on ~/ticks: a bag of '
                           'them can be replayed to the last digit.')
    thread_priority: int = parameter(
        40, low=0, high=98,
        description='Real-time priority (SCHED_FIFO) of the loop, where the system grants it; 0 '
                    'for none. Without it a busy machine makes the period jitter.')
    static_obstacles: tuple[str, ...] = parameter(
        (), description='Names of fixed obstacles; each has the parameters '
                        'static_obstacle.NAME.shape (ellipsoid, box, cylinder, capsule), .size '
                        '(full extents) and .pose (x y z, and roll pitch yaw or a quaternion '
                        'x y z w). See docs/obstacles.md.')
    workspace: tuple[float, ...] = parameter(
        (), low=-1e6, high=1e6, unit='m', runtime=True,
        description='Walls that no link crosses: x_min, y_min, z_min, x_max, y_max, z_max in the '
                    'base frame. Links that start beyond a wall may come in, not go further out.')

    def __post_init__(self) -> None:
        """Check every value."""
        check(self)
        walls(self.workspace)
        if not self.obstacle_topics or len(set(self.obstacle_topics)) < len(self.obstacle_topics):
            raise ParameterError(f"parameter 'obstacle_topics' is {list(self.obstacle_topics)}; "
                                 'it takes one topic at least, each once')


@dataclass(frozen=True)
class FakeHardwareParameters:
    """What fake_hardware_node needs besides the URDF.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    rate: int = parameter(
        250, low=1, high=1000, unit='Hz',
        description="Rate of joint_states, and of /clock: there it must be planner_node's.")
    command_timeout: float = parameter(
        0.05, low=0.001, high=10.0, unit='s',
        description='The arm holds still when no joint_command came for this long.')
    initial_joints: tuple[str, ...] = parameter(
        (), description='Joints that do not start at 0.')
    initial_positions: tuple[float, ...] = parameter(
        (), low=-1e6, high=1e6, unit='rad, m',
        description='One start position per name in initial_joints.')
    lag: float = parameter(
        0.0, low=0.0, high=1.0, unit='s',
        description='Dead time between a command and the motion it causes.')
    noise: float = parameter(
        0.0, low=0.0, high=0.1, unit='rad, m',
        description='Standard deviation of the noise on published positions.')
    wrap_continuous: bool = parameter(
        False, description='Whether joints that turn without end are published within (−π, π], '
                           'as most drivers do. If not, their positions go on for ever.')
    thread_priority: int = parameter(
        40, low=0, high=98,
        description='Real-time priority (SCHED_FIFO), where the system grants it; 0 for none. '
                    'Without it a busy machine interrupts joint_states, as no real arm would.')

    def __post_init__(self) -> None:
        """Check every value and the relations between them."""
        check(self)
        if len(self.initial_joints) != len(self.initial_positions):
            raise ParameterError(
                f"parameter 'initial_positions' has {len(self.initial_positions)} entries; it "
                f"takes {len(self.initial_joints)}, one per name in 'initial_joints'")


@dataclass(frozen=True)
class ClockParameters:
    """How a simulated arm sets the pace of all nodes.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    clock: bool = parameter(
        False, description='Whether the arm publishes /clock, for other nodes with use_sim_time. '
                           'Each of its periods then waits for the joint_command of the last '
                           'one, and takes no longer than that.')
    wait_for_cmd_vel: bool = parameter(
        False, description='With clock: whether each period waits for a cmd_vel (Twist), too. Its '
                           'sender publishes one per period. No twist comes late then.')
    real_time_factor: float = parameter(
        0.0, low=0.0, high=1000.0,
        description='With clock: how much faster than real time it may be; 0 for as fast as the '
                    'nodes can.')
    answer_timeout: float = parameter(
        0.5, low=0.01, high=60.0, unit='s',
        description='With clock: how long the arm waits for an answer, in real time. '
                    'Nobody who answers: time goes on at its real pace. Short, and a planner '
                    'that the system interrupts loses the step.')

    def __post_init__(self) -> None:
        """Check every value."""
        check(self)


@dataclass(frozen=True)
class PlayerParameters:
    """What scenario_player needs.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    scenario: str = parameter(
        '', description='Scenario file: a path, file:// or package:// location. Required.')
    urdf: str = parameter(
        '', description="URDF file to use instead of the scenario's robot file's.")
    rate: int = parameter(
        200, low=1, high=1000, unit='Hz',
        description='Rate of cmd_vel. By simulated time, no more than that of /clock.')
    subscribers: int = parameter(
        1, low=1, high=100,
        description='The motion starts once this many nodes listen on its topics: 2 where a '
                    'recorder must not miss the beginning.')
    preview: bool = parameter(
        True, description='Whether the whole twist is announced on cmd_vel_preview before the '
                          'motion, for planners that look ahead.')
    settle: float = parameter(
        1.0, low=0.0, high=60.0, unit='s',
        description='How long the twist stays zero before the motion, while the middleware gets '
                    'used to the new node, and after it.')
    thread_priority: int = parameter(
        40, low=0, high=98,
        description='Real-time priority (SCHED_FIFO), where the system grants it; 0 for none. '
                    'Without it a busy machine interrupts cmd_vel, and so the arm.')

    def __post_init__(self) -> None:
        """Check every value."""
        check(self)
