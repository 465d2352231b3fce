"""The driver's controls: speeds, sliders, the handle at the tip, stop, pause and reset."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin
import viser

from redundant_planner.core.robot.se3 import Pose
from redundant_planner.playground.arm_view import wxyz_of
from redundant_planner.playground.drive import FASTEST_ANGULAR, FASTEST_LINEAR, SLIDERS_KEY, Speeds
from redundant_planner.playground.world import FAR

Array = npt.NDArray[np.float64]

_HELP = """Hold a key: **W S** ±x, **A D** ±y, **Q E** ±z, arrows and **R F** turn, **Shift**
slower. A gamepad: hold a shoulder button. Or drag the handle at the tip. **Letting go stops the
arm.**"""
# Length of the arrows at the tip [m].
HANDLE_SIZE = 0.22
# Stands for the key that has the arm follow the sliders; page.js minds it.
_HOLD = f"""<button data-held="{SLIDERS_KEY}" style="width: calc(100% - 1.2em); margin: .3em .6em;
padding: .6em; border: 0; border-radius: 4px; background: #228be6; color: white; font-size: .875em;
touch-action: none; user-select: none; cursor: pointer">Hold to drive (or hold Space)</button>"""
_AXES = ('vx [m/s]', 'vy [m/s]', 'vz [m/s]', 'wx [rad/s]', 'wy [rad/s]', 'wz [rad/s]')


class DriveControls:
    """What the driver drives with.

    Attributes:
        stops_at_release: whether letting go of the handle stops the arm.
        drags: whether a handle is held.
    """

    def __init__(
        self, client: viser.ClientHandle, later: Callable[..., None], *, stops_at_release: bool,
        stop: Callable[[], object], pause: Callable[[bool], object],
        reset: Callable[[], object], couple: Callable[[bool], object],
    ) -> None:
        """Put the controls on the driver's page.

        Args:
            client: the driver.
            later: has a function called in the loop of the page, with its arguments.
            stops_at_release: whether letting go of the handle stops the arm, at first.
            stop, pause, reset, couple: called when the driver wants it.
        """
        gui: Any = client.gui  # where mypy takes values for read-only
        self._client, self._later, self._couple = client, later, couple
        self.drags = False
        self._targets: dict[str, Pose] = {}
        self._released = False
        self._handles: dict[str, Any] = {}
        self._tips: tuple[str, ...] = ()
        self._of_tips: list[Any] = []
        with gui.add_folder('Drive', order=2):
            gui.add_markdown(_HELP)
            self._linear = gui.add_slider('tip speed [m/s]', 0.01, FASTEST_LINEAR, 0.01, 0.15)
            self._angular = gui.add_slider('turn speed [rad/s]', 0.05, FASTEST_ANGULAR, 0.05, 0.5)
            stopping = gui.add_button('Stop', color='red')
            resetting = gui.add_button('Reset the path')
            pausing = gui.add_checkbox('pause the planner', False)
            self._stops = gui.add_checkbox(
                'stop when the handle is let go', stops_at_release,
                hint='otherwise the arm goes on to where the handle is')
            with gui.add_folder('A twist by sliders', expand_by_default=False):
                self._axes = [
                    gui.add_slider(name, -fastest, fastest, 0.01, 0.0) for name, fastest in zip(
                        _AXES, (*(FASTEST_LINEAR,) * 3, *(FASTEST_ANGULAR,) * 3))]
                gui.add_html(_HOLD)
                zeroing = gui.add_button('All to zero')

        async def zero(event: Any) -> None:
            for axis in self._axes:
                axis.value = 0.0

        async def stopped(event: Any) -> None:
            later(stop)

        async def pauses(event: Any) -> None:
            later(pause, bool(event.target.value))

        async def resets(event: Any) -> None:
            later(reset)

        zeroing.on_click(zero)
        stopping.on_click(stopped)
        resetting.on_click(resets)
        pausing.on_update(pauses)

    def offer(self, tips: tuple[str, ...]) -> None:
        """Let the driver choose among several tips, and have them hold one object."""
        if tips == self._tips:
            return
        gui: Any = self._client.gui
        for control in self._of_tips:
            control.remove()
        self._tips, self._of_tips = tips, []
        if not tips:
            return
        with gui.add_folder('Hands', order=1.8) as folder:
            choice = gui.add_dropdown('keys move', tips)
            coupling = gui.add_checkbox('both hands hold one object', False,
                                        hint='while the arms stand still')

        async def couples(event: Any) -> None:
            self._later(self._couple, bool(event.target.value))

        coupling.on_update(couples)
        self._of_tips = [choice, coupling, folder]

    @property
    def tip(self) -> str:
        """Which of several tips keys and sliders move; empty for the only one."""
        return str(self._of_tips[0].value) if self._of_tips else ''

    @property
    def stops_at_release(self) -> bool:
        """Whether letting go of the handle stops the arm."""
        return bool(self._stops.value)

    @property
    def speeds(self) -> Speeds:
        """How fast keys and sticks move the tip."""
        return Speeds(_sound(self._linear.value), _sound(self._angular.value))

    @property
    def sliders(self) -> Array:
        """The sliders' twist (6,)."""
        return np.array([_sound(axis.value) for axis in self._axes])

    def take(self) -> tuple[dict[str, Pose], bool]:
        """Return where handles were dragged since the last call, and whether one was let go."""
        found = self._targets, self._released
        self._targets, self._released = {}, False
        return found

    def follow(self, places: Mapping[str, Pose], still: Collection[str]) -> None:
        """Have a handle for each thing that can be moved, and put it there while none is held.

        Args:
            places: what can be moved → where it is; '' for the only tip.
            still: whose handle stays where it is.
        """
        for gone in self._handles.keys() - places.keys():
            self._handles.pop(gone).remove()
            self.drags = False
        for name, place in places.items():
            is_new = name not in self._handles
            if is_new:
                self._handles[name] = self._handle(name)
            if is_new or not (self.drags or name in still):
                self._handles[name].position = place.position
                self._handles[name].wxyz = wxyz_of(place.rotation)

    def _handle(self, name: str) -> viser.TransformControlsHandle:
        """Add the handle of a tip, or of what the tips hold."""
        handle = self._client.scene.add_transform_controls(
            f'/handle_{name}' if name else '/handle', scale=HANDLE_SIZE, depth_test=False)

        async def dragged(event: Any) -> None:
            self._later(self._dragged, name, event.phase, np.array(event.target.position),
                        np.array(event.target.wxyz))

        handle.on_update(dragged)
        return handle

    def _dragged(self, name: str, phase: str, position: Array, wxyz: Array) -> None:
        """Note one event of a drag; a place that is none counts for nothing."""
        self.drags = phase != 'end'
        self._released = self._released or phase == 'end'
        size = float(np.linalg.norm(wxyz))
        if (np.abs(position) <= FAR).all() and 0.5 < size < 2.0:
            w, x, y, z = (wxyz / size).tolist()
            self._targets[name] = Pose(position, pin.Quaternion(w, x, y, z).toRotationMatrix())


def _sound(value: float) -> float:
    """Return a slider's value; 0 if a browser sends what is no number."""
    return float(value) if math.isfinite(value) else 0.0
