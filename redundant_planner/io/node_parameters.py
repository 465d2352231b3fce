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
        description='An older cmd_vel counts as zero. Too long, and the arm runs on after its '
                    'operator has gone.')
    joint_state_timeout: float = parameter(
        0.1, low=0.005, high=10.0, unit='s', runtime=True,
        description='Without joint_states for this long the arm stops and the node is silent.')
    follow_tolerance: float = parameter(
        0.02, low=0.0, high=1.0, unit='rad, m', runtime=True, group='follow',
        description='How far a joint may stay behind its commands, besides known delays; 0 for '
                    'any. Too small, and a load or play stops the arm.')
    drive_goes_on: bool = parameter(
        True, runtime=True, group='drive',
        description="Whether the arm goes on by its last command where none follows in time, as "
                    "one that takes joint_command's velocities does. false if it takes its "
                    'positions.')
    enable_stamped_cmd_vel: bool = parameter(
        False, description='cmd_vel is a TwistStamped, with its frame (base or tip) and time.')
    obstacle_topics: tuple[str, ...] = parameter(
        ('obstacles',),
        description='Topics with obstacles (MarkerArray); ~/body of another planner_node is an '
                    'arm.')
    estimate_obstacle_velocity: bool = parameter(
        False, runtime=True,
        description="Estimates obstacles' velocities, to evade earlier. Noisy detections make the "
                    'arm flinch.')
    outputs: tuple[str, ...] = parameter(
        (), choices=OUTPUTS,
        description='Topics besides joint_command, for controllers of ros2_control.')
    publish_ticks: bool = parameter(
        False, description='Whether ~/ticks has every input of every tick, for an exact replay.')
    thread_priority: int = parameter(
        40, low=0, high=98,
        description='Real-time priority (SCHED_FIFO); 0 for none. Without it a busy machine makes '
                    'the period jitter.')
    static_obstacles: tuple[str, ...] = parameter(
        (), description='Names; each has static_obstacle.NAME.shape, .size and .pose '
                        '(docs/obstacles.md).')
    workspace: tuple[float, ...] = parameter(
        (), low=-1e6, high=1e6, unit='m', runtime=True,
        description='Walls that no link crosses: x_min, y_min, z_min, x_max, y_max, z_max.')

    def __post_init__(self) -> None:
        """Check every value."""
        check(self)
        walls(self.workspace)
        if not self.obstacle_topics or len(set(self.obstacle_topics)) < len(self.obstacle_topics):
            raise ParameterError(f"parameter 'obstacle_topics' is {list(self.obstacle_topics)}; "
                                 'it takes one topic at least, each once')


@dataclass(frozen=True)
class SimulatedArmParameters:
    """What each node with a simulated arm needs besides the robot.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    rate: int = parameter(
        250, low=1, high=1000, unit='Hz',
        description="Rate of joint_states, and of /clock: then planner_node's.")
    initial_joints: tuple[str, ...] = parameter(
        (), description='Joints that do not start at 0.')
    initial_positions: tuple[float, ...] = parameter(
        (), low=-1e6, high=1e6, unit='rad, m',
        description='One start position per name in initial_joints.')
    noise: float = parameter(
        0.0, low=0.0, high=0.1, unit='rad, m',
        description='Standard deviation of the noise on published positions.')
    wrap_continuous: bool = parameter(
        False, description='Whether continuous joints are published within (−π, π], as most '
                           'drivers do.')
    thread_priority: int = parameter(
        40, low=0, high=98,
        description="Real-time priority (SCHED_FIFO), as planner_node's.")

    def __post_init__(self) -> None:
        """Check every value and the relations between them."""
        check(self)
        if len(self.initial_joints) != len(self.initial_positions):
            raise ParameterError(
                f"parameter 'initial_positions' has {len(self.initial_positions)} entries; it "
                f"takes {len(self.initial_joints)}, one per name in 'initial_joints'")


@dataclass(frozen=True)
class FakeHardwareParameters(SimulatedArmParameters):
    """What fake_hardware_node needs besides the URDF.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    command_timeout: float = parameter(
        0.05, low=0.001, high=10.0, unit='s',
        description='Without joint_command for this long the arm holds still.')
    lag: float = parameter(
        0.0, low=0.0, high=1.0, unit='s',
        description='Dead time between a command and the motion it causes.')


@dataclass(frozen=True)
class ClockParameters:
    """How a simulated arm sets the pace of all nodes.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    clock: bool = parameter(
        False, description='Whether the arm publishes /clock. Each period then waits for the last '
                           "one's joint_command.")
    wait_for_cmd_vel: bool = parameter(
        False, description='With clock: whether each period waits for a cmd_vel (Twist), too.')
    real_time_factor: float = parameter(
        0.0, low=0.0, high=1000.0,
        description='With clock: how much faster than real time; 0 for as fast as the nodes can.')
    answer_timeout: float = parameter(
        0.5, low=0.01, high=60.0, unit='s',
        description='With clock: longest wait for an answer. Too short, and an interrupted '
                    'planner loses the step.')

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
        '', description='Scenario file: a path, file:// or package://. Required.')
    urdf: str = parameter(
        '', description="URDF file to use instead of the scenario's robot file's.")
    rate: int = parameter(
        200, low=1, high=1000, unit='Hz',
        description="Rate of cmd_vel; with simulated time, no more than /clock's.")
    subscribers: int = parameter(
        1, low=1, high=100,
        description='The motion starts once so many nodes listen.')
    preview: bool = parameter(
        True, description='Whether cmd_vel_preview announces the whole twist before the motion.')
    settle: float = parameter(
        1.0, low=0.0, high=60.0, unit='s',
        description='How long the twist stays zero before and after the motion.')
    thread_priority: int = parameter(
        40, low=0, high=98,
        description="Real-time priority (SCHED_FIFO), as planner_node's.")

    def __post_init__(self) -> None:
        """Check every value."""
        check(self)
