"""The driver's controls for obstacles: add, choose, resize, move, delete."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from dataclasses import replace
import math
from typing import Any

import numpy as np
import viser

from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, ELLIPSOID
from redundant_planner.playground.world import Item, LARGEST, SMALLEST, World

_NOTHING = '(none)'
_AXES = {'x': 0, 'y': 1, 'z': 2}
# What the buttons call the shapes.
_ADDED = {'ball': ELLIPSOID, 'box': BOX, 'cylinder': CYLINDER, 'capsule': CAPSULE}


class ItemControls:
    """What the driver changes obstacles with.

    Attributes:
        chosen: name of the item that the controls are about; empty for none.
    """

    def __init__(
        self, client: viser.ClientHandle, world: World, later: Callable[..., None],
        add: Callable[[str], object], change: Callable[[Item], object],
    ) -> None:
        """Put the controls on the driver's page.

        Args:
            client: the driver.
            world: the items.
            later: has a function called in the loop of the page, with its arguments.
            add: takes the shape of an item to add.
            change: takes an item to put in the place of the one of its name.
        """
        self.chosen = ''
        self._world, self._change, self._shown = world, change, None
        self._client = client
        gui: Any = client.gui  # where mypy takes values for read-only
        with gui.add_folder('Obstacles', order=3):
            gui.add_markdown('Drag one to move it. Click one to change it here.')
            # A group of buttons would not tell of one that is pressed twice.
            adding = {shape: gui.add_button(f'+ {name}') for name, shape in _ADDED.items()}
            self._choice = gui.add_dropdown('chosen', (_NOTHING,))
            self._sizes = [gui.add_slider(f'size {axis} [m]', SMALLEST, 1.0, 0.01, 0.1)
                           for axis in 'xyz']
            self._moves = gui.add_dropdown('moves along', ('nothing', *_AXES))
            self._swing = gui.add_slider('to and fro by [m]', 0.05, 1.0, 0.05, 0.25)
            self._period = gui.add_slider('in [s]', 1.0, 20.0, 0.5, 5.0)
            deleting = gui.add_button('Delete')
            clearing = gui.add_button('Delete all')
        self._gizmo = client.scene.add_transform_controls(
            '/chosen', scale=0.3, disable_sliders=True, visible=False, depth_test=False)

        async def chooses(event: Any) -> None:
            if event.client_id is not None:  # a visitor's, not ours
                later(self.choose, str(event.target.value))

        async def changes(event: Any) -> None:
            if event.client_id is not None:
                later(self._changed)

        async def turns(event: Any) -> None:
            later(self._turned, np.array(event.target.position), np.array(event.target.wxyz))

        async def deletes(event: Any) -> None:
            later(self._deleted)

        async def clears(event: Any) -> None:
            later(world.load, ())

        for shape, button in adding.items():
            button.on_click(_adder(later, add, shape))
        self._choice.on_update(chooses)
        for control in (*self._sizes, self._swing, self._period):
            control.on_update(changes)
        self._moves.on_update(changes)
        self._gizmo.on_update(turns)
        deleting.on_click(deletes)
        clearing.on_click(clears)

    def choose(self, name: str) -> None:
        """Have the controls be about an item."""
        self.chosen = name if name in self._world.items else ''

    def show(self, now: float, dragged: str) -> None:
        """Show what there is to choose, and the chosen item.

        Args:
            now: time by which things move [s].
            dragged: name of an item that is being dragged.
        """
        items = self._world.items
        if self.chosen not in items:
            self.chosen = ''
        options = (_NOTHING, *items)
        if tuple(self._choice.options) != options:
            self._choice.options = options
        if self._choice.value != (self.chosen or _NOTHING):
            self._choice.value = self.chosen or _NOTHING
        item = items.get(self.chosen)
        self._gizmo.visible = item is not None and not item.moves and not dragged
        if item is not None and item is not self._shown:
            w = item.orientation[3]
            self._gizmo.position = np.array(item.place(now))
            self._gizmo.wxyz = np.array((w, *item.orientation[:3]))
            for control, size in zip(self._sizes, item.size):
                control.value = min(max(size, SMALLEST), 1.0)
            along = max(_AXES, key=lambda axis: abs(item.swing[_AXES[axis]]))
            self._moves.value = along if item.moves else 'nothing'
            if item.moves:
                self._swing.value = min(max(math.hypot(*item.swing), 0.05), 1.0)
                self._period.value = min(max(item.period, 1.0), 20.0)
        self._shown = item  # type: ignore[assignment]

    def _changed(self) -> None:
        """Make the chosen item what the controls say."""
        item = self._world.items.get(self.chosen)
        if item is None:
            return
        swing = [0.0, 0.0, 0.0]
        if self._moves.value in _AXES:
            swing[_AXES[self._moves.value]] = float(self._swing.value)
        sizes = tuple(min(float(control.value), LARGEST) for control in self._sizes)
        # A slider that has not been touched leaves a size beyond its end alone.
        kept = tuple(old if old > 1.0 and new >= 1.0 else new
                     for old, new in zip(item.size, sizes))
        self._change(replace(item, size=kept, swing=tuple(swing), period=float(
            self._period.value)))

    def _turned(self, position: Any, wxyz: Any) -> None:
        item = self._world.items.get(self.chosen)
        if item is not None:
            w, x, y, z = wxyz.tolist()
            self._change(replace(
                item, position=tuple(position.tolist()), orientation=(x, y, z, w)))

    def _deleted(self) -> None:
        self._world.remove(self.chosen)


def _adder(
    later: Callable[..., None], add: Callable[[str], object], shape: str,
) -> Callable[[Any], Coroutine[Any, Any, None]]:
    async def adds(event: Any) -> None:
        later(add, shape)
    return adds
