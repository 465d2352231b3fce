"""quick_start with a simulated arm that says where it is as real drivers do.

    python -m benchmark.drivers --wrapped --parts my_robot.urdf --out folder

Options ahead of quick_start's own: `--wrapped` for joints without end within (−π, π], `--parts`
for joint states of two publishers, each with half of the joints.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
import subprocess

from benchmark import joint_states_in_halves
from redundant_planner.tools import quick_start


class Drivers(quick_start.Nodes):
    """Arm and planner, and what is between them."""

    def __init__(self, domain: int, *, wrapped: bool, parts: bool) -> None:
        """Prepare for processes on a ROS domain.

        Args:
            domain: of ROS.
            wrapped: whether joints without end are said within (−π, π].
            parts: whether joint states come from two publishers.
        """
        super().__init__(domain)
        self._wrapped, self._parts = wrapped, parts

    def start(
        self, node: str | Path, files: Sequence[Path] = (),
        values: Mapping[str, object] | None = None, remap: Mapping[str, str] | None = None,
        name: str = '', options: Sequence[str] = (),
    ) -> subprocess.Popen[bytes]:
        """Start a node; the arm with what lies between it and the planner."""
        if node == quick_start.ARM:
            values = {**(values or {}), 'wrap_continuous': self._wrapped}
            if self._parts:
                super().start(Path(joint_states_in_halves.__file__), name='halves')
                remap = {**(remap or {}), 'joint_states': joint_states_in_halves.WHOLE}
        return super().start(node, files, values, remap, name, options)


def main(args: list[str] | None = None) -> int:
    """Run quick_start."""
    parser = argparse.ArgumentParser(prog='benchmark.drivers', description=__doc__)
    parser.add_argument('--wrapped', action='store_true')
    parser.add_argument('--parts', action='store_true')
    options, rest = parser.parse_known_args(args)
    return quick_start.main(
        rest, partial(Drivers, wrapped=options.wrapped, parts=options.parts))


if __name__ == '__main__':
    raise SystemExit(main())
