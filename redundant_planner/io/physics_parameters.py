"""What mujoco_hardware_node needs besides the robot.

Not in nodes/, for tools without ROS read the same parameter files.
"""

from __future__ import annotations

from dataclasses import dataclass

from redundant_planner.core.parameters import check, parameter
from redundant_planner.io.node_parameters import SimulatedArmParameters

VELOCITY_SERVO, POSITION_SERVO, NO_SERVO = 'velocity', 'position', 'off'


@dataclass(frozen=True)
class PhysicsParameters:
    """How the simulated arm's joints and drives differ from ideal ones.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    physics_rate: int = parameter(
        1000, low=100, high=10_000, unit='Hz',
        description='Steps of physics per second. Too slow, and contacts are soft and the servo '
                    'shakes.')
    servo: str = parameter(
        VELOCITY_SERVO, choices=(VELOCITY_SERVO, POSITION_SERVO, NO_SERVO),
        description='How drives take joint_command: as velocity, position, or off: no torque, the '
                    'arm falls.')
    servo_bandwidth: float = parameter(
        15.0, low=0.5, high=100.0, unit='Hz',
        description='Natural frequency of the servo, critically damped. Real arms have 5 to 30 '
                    'Hz; a slow servo sags and lags.')
    armature: float = parameter(
        0.1, low=0.0, high=100.0, unit='kg m², kg',
        description="Inertia of a drive's rotor, times its gear's ratio squared. Without it small "
                    'links shake.')
    joint_damping: float = parameter(
        1.0, low=0.0, high=1000.0, unit='Nm s/rad, N s/m',
        description='Viscous friction of each joint, unknown to the servo.')
    gravity: tuple[float, ...] = parameter(
        (0.0, 0.0, -9.81), low=-100.0, high=100.0, size=3, unit='m/s²',
        description='Gravity in the axes of the root link, for an arm on a wall or a ceiling.')
    mass_error: float = parameter(
        0.0, low=-0.9, high=10.0,
        description='How much heavier the arm is than its URDF, as a share. The servo compensates '
                    "the URDF's mass.")
    lag: float = parameter(
        0.0, low=0.0, high=1.0, unit='s',
        description='Dead time between a command and the motion it causes.')
    command_timeout: float = parameter(
        0.05, low=0.001, high=10.0, unit='s',
        description='Without joint_command for this long the arm holds still.')

    def __post_init__(self) -> None:
        """Check every value."""
        check(self)


@dataclass(frozen=True)
class MujocoHardwareParameters(SimulatedArmParameters):
    """What mujoco_hardware_node needs besides the robot and the physics.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    static_obstacles: tuple[str, ...] = parameter(
        (), description='Fixed obstacles that are bodies, as for planner_node.')
