"""Stand-ins for ROS's launch, which tests do not have: they note what a launch file makes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
import runpy
import sys
from types import ModuleType, SimpleNamespace

import pytest

from redundant_planner.io.resources import share_directory

KINDS = {'launch': ['LaunchDescription'],
         'launch.actions': ['DeclareLaunchArgument', 'LogInfo', 'OpaqueFunction'],
         'launch.conditions': ['IfCondition'], 'launch.substitutions': ['LaunchConfiguration'],
         'launch_ros': [], 'launch_ros.actions': ['Node'],
         'launch_ros.parameter_descriptions': ['ParameterValue']}


class Noted(SimpleNamespace):
    """Keeps the arguments that it is made with."""

    def __init__(self, *args, **kwargs):
        super().__init__(args=args, **kwargs)

    def perform(self, context):
        """Return the value of a launch argument."""
        return context[self.args[0]]


def launch_file(
    monkeypatch: pytest.MonkeyPatch, folder: Path, name: str, packages: Iterable[str],
) -> Callable[..., list[Noted]]:
    """Return what starts a launch file's functions with arguments, and returns the nodes.

    Args:
        monkeypatch: of the test.
        folder: an empty one.
        name: of the launch file, without its ending.
        packages: that are installed.
    """
    for module, names in KINDS.items():
        made = ModuleType(module)
        for kind in names:
            setattr(made, kind, type(kind, (Noted,), {}))
        monkeypatch.setitem(sys.modules, module, made)
    index = ModuleType('ament_index_python.packages')
    index.get_package_share_directory = lambda name: str(share_directory())
    monkeypatch.setitem(sys.modules, 'ament_index_python', ModuleType('ament_index_python'))
    monkeypatch.setitem(sys.modules, 'ament_index_python.packages', index)
    for package in packages:
        (folder / 'share' / package).mkdir(parents=True, exist_ok=True)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(folder))
    file = runpy.run_path(str(share_directory() / 'launch' / f'{name}.launch.py'))

    def start(**given):
        actions = file['generate_launch_description']().args[0]
        context = {action.args[0]: action.default_value for action in actions
                   if hasattr(action, 'default_value')} | given
        nodes = []
        for action in actions:
            condition = getattr(action, 'condition', None)
            if condition and context[condition.args[0].args[0]] != 'true':
                continue
            if hasattr(action, 'function'):
                nodes += action.function(context)
            elif hasattr(action, 'package'):
                nodes.append(action)
        return nodes

    return start
