"""Where the joints are at one posture: the one place that reads Pinocchio's memory.

`pin.computeJointJacobians` takes two microseconds. Asking for the results joint by joint would
take ten times as long, so they are read through array views. Pinocchio's Python interface hands
out J as an array, but each joint's placement as an object of its own. These objects lie one after
another in a C++ vector; a view with the distance between two of them as its stride shows them
all. Nothing promises this layout. It was tested with Pinocchio 4.1.0; where it does not hold, the
placements are copied one by one.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio as pin

Array = npt.NDArray[np.float64]


class JointFrames:
    """The joint screws and placements of one arm, at one posture after the other."""

    def __init__(self, model: pin.Model) -> None:
        """Prepare for a chain."""
        self._model, self._data = model, model.createData()
        # Pinocchio shows the J of a single joint as a vector.
        self._screws: Array = self._data.J.T.reshape(-1, 6)
        placements = _placement_views(self._data)
        self._views = None if placements is None else (self._screws, *placements)

    def at(self, q: Array) -> tuple[Array, Array, Array]:
        """Return the joints' screws and placements at a posture (n,), which is not checked.

        The arrays are views: the next call overwrites them.

        Returns:
            (n, 6) joint screws [v; w] with v taken at the base origin, and (n + 1, 3, 3)
            rotations and (n + 1, 3) positions of all joints [m], the base first; all in the base
            frame.
        """
        pin.computeJointJacobians(self._model, self._data, q)
        if self._views is not None:
            return self._views
        return (self._screws, *_placement_copies(self._data))


def _placement_views(data: pin.Data) -> tuple[Array, Array] | None:
    """Return views of the rotations and positions of all joints; None if that cannot be done."""
    views = []
    for part in ('rotation', 'translation'):
        parts = [getattr(placement, part) for placement in data.oMi]
        addresses = [array.ctypes.data for array in parts]
        strides = set(np.diff(addresses).tolist())
        if len(strides) != 1:
            return None
        views.append(np.lib.stride_tricks.as_strided(
            parts[0], (len(parts), *parts[0].shape), (strides.pop(), *parts[0].strides),
            writeable=False))
    return views[0], views[1]


def _placement_copies(data: pin.Data) -> tuple[Array, Array]:
    """Return the rotations and positions of all joints, copied one by one."""
    return (np.array([placement.rotation for placement in data.oMi]),
            np.array([placement.translation for placement in data.oMi]))
