"""What cloud_obstacles, planning_scene_obstacles and depth_camera need besides the robot.

Not in nodes/, for tools without ROS read the same parameter files.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.obstacles.workspace import check_box
from redundant_planner.core.parameters import check, parameter

# Quaternions further from unit length than this are a mistake, not round-off.
_QUATERNION_TOLERANCE = 0.01


@dataclass(frozen=True)
class CloudParameters:
    """What cloud_obstacles needs besides the robot.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    sensor_pose: tuple[float, ...] = parameter(
        (), low=-1e3, high=1e3, unit='m', runtime=True,
        description="Pose of the clouds' frame in the base frame: x y z and a quaternion; empty "
                    'for tf2. Off by more than self_margin, and the arm sees itself.')
    sensor_frame: str = parameter(
        '', runtime=True,
        description='Frame that sensor_pose is of; other clouds are looked up in tf2. Empty: '
                    'every frame.')
    crop_box: tuple[float, ...] = parameter(
        (), low=-1e3, high=1e3, unit='m', runtime=True,
        description='Points outside do not count: x_min y_min z_min x_max y_max z_max in the base '
                    'frame; empty for none.')
    reach_margin: float = parameter(
        0.2, low=0.0, high=10.0, unit='m', runtime=True,
        description="How far beyond the arm's reach points count. Too small, and the planner sees "
                    'obstacles late.')
    self_margin: float = parameter(
        0.03, low=0.0, high=0.5, unit='m', runtime=True,
        description='Points this close to the arm are the arm. Too small, and it sees itself; too '
                    'large, and it misses what comes near.')
    stamp_uncertainty: float = parameter(
        0.01, low=0.0, high=1.0, unit='s', runtime=True,
        description='Difference between the stamps of clouds and joint_states; links get thicker '
                    'by it.')
    voxel_size: float = parameter(
        0.025, low=0.005, high=1.0, unit='m',
        description='Edge of the cubes. Small ones cost time, large ones close gaps that the arm '
                    'would fit through.')
    min_points: int = parameter(
        2, low=1, high=1000, runtime=True,
        description='A cube with fewer points is noise. Too many, and distant or thin things '
                    'vanish.')
    persistence: float = parameter(
        2.0, low=0.0, high=3600.0, unit='s', runtime=True,
        description='How long a hidden cube stays. Too short, and the arm forgets what it hides; '
                    'too long, and old cubes block it.')
    ray_clearing: bool = parameter(
        True, runtime=True,
        description='Whether a cube is free once the sensor sees through it; only for clouds in '
                    'its own frame.')
    self_capsules: tuple[str, ...] = parameter(
        (), description='Other shapes that are no obstacles; each has self_capsule.NAME.frame, '
                        '.start, .end and .radius.')

    def __post_init__(self) -> None:
        """Check every value and the relations between them."""
        check(self)
        _check_pose('sensor_pose', self.sensor_pose)
        check_box('crop_box', self.crop_box)


@dataclass(frozen=True)
class SceneParameters:
    """What planning_scene_obstacles needs besides the robot.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    scene_planner: str = parameter(
        'planner_node', group='scene',
        description='Node whose allowed_contacts follow the scene. Empty for none: a gripper then '
                    'keeps its distance.')
    scene_reach_margin: float = parameter(
        0.5, low=0.0, high=10.0, unit='m', group='scene',
        description="How far beyond the arm's reach cubes of an octomap count. Too small, and the "
                    'planner sees them late.')
    allowed_contacts: tuple[str, ...] = parameter(
        (), description='Contacts allowed besides those of the scene, as for planner_node.')

    def __post_init__(self) -> None:
        """Check every value."""
        check(self)


@dataclass(frozen=True)
class CameraParameters:
    """What depth_camera needs besides the robot.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    camera_rate: float = parameter(
        15.0, low=0.1, high=100.0, unit='Hz', description='Rate of points.')
    camera_frame: str = parameter(
        'camera', description='Frame of the clouds, with the axes of an image: x right, y down, z '
                              'forward.')
    camera_pose: tuple[float, ...] = parameter(
        (1.5, 0.0, 1.2, 0.615324, 0.615324, -0.348391, -0.348391), low=-1e3, high=1e3, unit='m',
        description='Pose of the camera in the base frame: x y z and a quaternion.')
    image_width: int = parameter(
        320, low=1, high=1920, description='Points in a row.')
    image_height: int = parameter(
        240, low=1, high=1080, description='Rows.')
    field_of_view: float = parameter(
        1.2, low=0.05, high=3.0, unit='rad', description='Angle between the left and right edge.')
    camera_range: float = parameter(
        5.0, low=0.1, high=100.0, unit='m',
        description='Points further away are NaN.')
    camera_noise: float = parameter(
        0.0, low=0.0, high=0.1, unit='m',
        description='Standard deviation of the distance along each ray.')

    def __post_init__(self) -> None:
        """Check every value."""
        check(self)
        if not self.camera_pose:
            raise ParameterError("parameter 'camera_pose' is empty; it takes 7 numbers")
        _check_pose('camera_pose', self.camera_pose)


def _check_pose(name: str, pose: tuple[float, ...]) -> None:
    """Make sure that a pose is empty, or a position and a unit quaternion.

    Raises:
        ParameterError: it is not.
    """
    if len(pose) not in (0, 7):
        raise ParameterError(f"parameter '{name}' has {len(pose)} entries; it takes 7, x y z and "
                             'a quaternion x y z w')
    length = math.hypot(*pose[3:])
    if pose and abs(length - 1.0) > _QUATERNION_TOLERANCE:
        raise ParameterError(f"parameter '{name}': its quaternion {list(pose[3:])} has length "
                             f'{length:.3g}; it must be 1')
