"""Installs the package for colcon (ament_python) and for pip alike."""

from glob import glob
from pathlib import Path
import re

from setuptools import find_packages, setup

PACKAGE = 'redundant_planner'
SHARE = f'share/{PACKAGE}'
# A placeholder, as the maintainer's address is, until the project has a home; package.xml, too.
HOME = f'https://example.com/{PACKAGE}'
# The README as an index shows it, where relative links lead nowhere.
README = re.sub(r'\]\((?!https?:|#)', f']({HOME}/blob/main/',
                (Path(__file__).resolve().parent / 'README.md').read_text(encoding='utf-8'))

# CI runs both ends of the range: `make lowest`, and the newest in all else.
NUMBA = 'numba>=0.59,<0.69'
# The real ROS 2 Jazzy as wheels; with ROS sourced, apt has them already.
JAZZY = ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces']
ANALYSIS = ['rosbags>=0.10', 'matplotlib>=3.6', 'plotly>=5.15', 'rich>=13']
# mujoco_hardware_node: an arm with mass (MuJoCo is Apache-2.0), matplotlib for its films.
MUJOCO = ['mujoco>=3.2', 'matplotlib>=3.6']
# playground: the page (viser is MIT), the Panda it begins with, and its bags' reports.
VIEWER = ['viser>=1.1,<2', 'example-robot-data', *ANALYSIS]
# For `python -m benchmark.…` alone: what is compared with, and the optimum.
# (cbfpy brings JAX, 0.6 GB, whose newest release takes Python 3.11 and later.)
BENCHMARK = ['casadi', 'mink', 'pin-pink', 'roboplan>=0.7', 'toppra>=0.6',
             'cbfpy>=0.1; python_version >= "3.11"']
# `make docs`; furo is the theme (MIT), myst-parser reads Markdown (MIT).
DOCS = ['furo', 'myst-parser', 'sphinx']
# A headless Chromium for the report's own test; half a gigabyte.
BROWSER = ['PySide6-WebEngine']
TEST = [
    'colcon-bash', 'colcon-core', 'colcon-package-information', 'colcon-python-setup-py',
    'colcon-ros', 'docutils', 'example-robot-data', 'hypothesis', 'markdown-it-py', 'mypy',
    'pytest', 'pytest-rerunfailures', 'ruff', 'types-PyYAML', 'xacro', *MUJOCO, *VIEWER,
]

setup(
    name=PACKAGE,
    version='0.3.0',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={PACKAGE: ['py.typed', 'playground/page.js']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (SHARE, ['package.xml']),
        (f'{SHARE}/launch', glob('launch/*')),
        *((f'{SHARE}/config/{folder}', glob(f'config/{folder}/*'))
          for folder in ('devices', 'middleware', 'perception', 'planner', 'robots',
                         'ros2_control', 'rviz', 'scenarios')),
    ],
    python_requires='>=3.10',
    # pin is Pinocchio on PyPI; apt's ros-jazzy-pinocchio provides the same module.
    install_requires=['setuptools', 'numpy>=1.26', NUMBA, 'scipy>=1.8', 'pin>=3', 'daqp>=0.5',
                      'PyYAML>=6'],
    extras_require={'jazzy': JAZZY, 'analysis': ANALYSIS, 'benchmark': BENCHMARK, 'test': TEST,
                    'browser': BROWSER, 'docs': DOCS, 'mujoco': MUJOCO,
                    'viewer': VIEWER},
    zip_safe=False,
    author='redundant_planner developers',
    maintainer='redundant_planner developers',
    maintainer_email='maintainers@example.com',
    description='Velocity-level redundancy resolution for robot arms among obstacles',
    long_description=README,
    long_description_content_type='text/markdown',
    url=HOME,
    project_urls={'Source': HOME,
                  'Changelog': f'{HOME}/blob/main/CHANGELOG.rst',
                  'Documentation': f'{HOME}/blob/main/docs/index.md'},
    keywords=['ROS 2', 'robot arm', 'redundancy resolution', 'inverse kinematics',
              'obstacle avoidance', 'null space'],
    classifiers=[
        'Development Status :: 4 - Beta',
        'Intended Audience :: Developers',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        *(f'Programming Language :: Python :: 3.{minor}' for minor in range(10, 14)),
        'Topic :: Scientific/Engineering',
        'Typing :: Typed',
    ],
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            f'planner_node = {PACKAGE}.nodes.planner_node:main',
            f'fake_hardware_node = {PACKAGE}.nodes.fake_hardware_node:main',
            f'mujoco_hardware_node = {PACKAGE}.nodes.mujoco_hardware_node:main',
            f'scenario_player = {PACKAGE}.nodes.scenario_player:main',
            f'cloud_obstacles = {PACKAGE}.nodes.cloud_obstacles:main',
            f'planning_scene_obstacles = {PACKAGE}.nodes.planning_scene_obstacles:main',
            f'depth_camera = {PACKAGE}.nodes.depth_camera:main',
            f'drive = {PACKAGE}.tools.drive:main',
            f'go_to = {PACKAGE}.tools.go_to:main',
            f'record_bag = {PACKAGE}.tools.record_bag:main',
            f'analyze_bag = {PACKAGE}.tools.analyze_bag:main',
            f'replay_bag = {PACKAGE}.tools.replay_bag:main',
            f'identify_delay = {PACKAGE}.tools.identify_delay:main',
            f'show_robot = {PACKAGE}.tools.show_robot:main',
            f'quick_start = {PACKAGE}.tools.quick_start:main',
            f'demo = {PACKAGE}.tools.demo:main',
            f'playground = {PACKAGE}.tools.playground:main',
            f'reproduce_paper = {PACKAGE}.tools.reproduce_paper:main',
        ],
    },
)
