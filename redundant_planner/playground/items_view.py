"""The obstacles on the page, which can be dragged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import viser

from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, HALF_SPACE, SHAPES
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.playground.arm_view import capsule_surface, Color, wxyz_of
from redundant_planner.playground.world import Item, item_name, Numbers

Array = npt.NDArray[np.float64]

_STILL, _MOVES, _CHOSEN = (214, 120, 84), (226, 170, 70), (245, 200, 150)
_OTHERS = (150, 150, 155)
_OPACITY = 0.85
# Obstacles of others that are shown: what a browser draws with ease.
_MOST_OTHERS = 400
# Sizes that agree to so many digits look alike [m].
_DIGITS = 4

# What is told of a drag: the item's name, where its middle is dragged to, whether it has ended.
Dragged = Callable[[int, str, Numbers, bool], object]


class ItemsView:
    """Draws items, and says where they are dragged."""

    def __init__(
        self, scene: viser.SceneApi, dragged: Dragged, clicked: Callable[[int, str], object],
    ) -> None:
        """Prepare.

        Args:
            scene: to draw into.
            dragged: takes visitor, item, place and end of a drag, on viser's thread.
            clicked: takes visitor and item.
        """
        self._scene, self._dragged, self._clicked = scene, dragged, clicked
        self._handles: dict[str, tuple[Item, Color, Any]] = {}

    def show(self, items: Mapping[str, Item], chosen: str, now: float) -> None:
        """Show items at a time [s], one of them chosen."""
        for name in [name for name in self._handles if name not in items]:
            self._handles.pop(name)[2].remove()
        for name, item in items.items():
            known, color, handle = self._handles.get(name, (None, _STILL, None))
            if known is None or _looks(known) != _looks(item):
                if handle is not None:
                    handle.remove()
                known, handle = None, self._drawn(item)
            assert handle is not None
            if known is not item or item.moves:
                handle.position = np.array(item.place(now))
                x, y, z, w = item.orientation
                handle.wxyz = np.array((w, x, y, z))
            wanted = _CHOSEN if name == chosen else _MOVES if item.moves else _STILL
            if known is None or wanted != color:
                handle.color = wanted
            self._handles[name] = item, wanted, handle

    def _drawn(self, item: Item) -> Any:
        handle = _solid(self._scene, f'/items/{item.name}', item.shape, item.size, _STILL)
        name = item.name
        begins: dict[int, tuple[Array, Array]] = {}

        async def drag(event: Any) -> None:
            # The whole item comes along with the point at which it was taken.
            if event.phase == 'start':
                begins[event.client_id] = (
                    np.array(event.end_position), np.array(handle.position))
            if event.client_id in begins:
                taken, middle = begins[event.client_id]
                place = middle + np.array(event.end_position) - taken
                self._dragged(event.client_id, name, tuple(place.tolist()), event.phase == 'end')
            if event.phase == 'end':
                begins.pop(event.client_id, None)

        async def click(event: Any) -> None:
            self._clicked(event.client_id, name)

        handle.on_drag(drag)
        handle.on_click(click)
        return handle


class OthersView:
    """Draws obstacles of others, from a planner's scene; they cannot be dragged."""

    def __init__(self, scene: viser.SceneApi) -> None:
        """Prepare to draw into a scene."""
        self._scene = scene
        self._shown: tuple[Scene | None, frozenset[str]] = (None, frozenset())
        # What stands in each place is drawn anew only if it looks different: where another arm
        # moves, all of them move in every picture.
        self._places: list[tuple[tuple[str, Numbers], Any]] = []

    def show(self, scene: Scene, left_out: frozenset[str]) -> None:
        """Show the obstacles of a scene.

        Args:
            scene: what the planner keeps clear of.
            left_out: names, and beginnings of names before a slash, of what is drawn otherwise.
        """
        if self._shown[0] is scene and self._shown[1] == left_out:
            return
        self._shown = scene, left_out
        rows = [i for i, name in enumerate(scene.names)
                if item_name(name) not in left_out and name.partition('/')[0] not in left_out
                and SHAPES[scene.shapes[i]] != HALF_SPACE][:_MOST_OTHERS]
        for _, handle in self._places[len(rows):]:
            handle.remove()
        del self._places[len(rows):]
        for place, row in enumerate(rows):
            self._show_one(place, scene, row)

    def _show_one(self, place: int, scene: Scene, row: int) -> None:
        shape = SHAPES[scene.shapes[row]]
        sizes = tuple(np.round(2.0 * scene.half_extents[row], _DIGITS).tolist())
        where = {'position': scene.centers[row], 'wxyz': wxyz_of(scene.rotations[row])}
        if place < len(self._places):
            looks, handle = self._places[place]
            if looks == (shape, sizes):
                handle.position, handle.wxyz = where['position'], where['wxyz']
                return
            handle.remove()
            del self._places[place]
        handle = _solid(self._scene, f'/others/{place}', shape, sizes, _OTHERS, **where)
        self._places.insert(place, ((shape, sizes), handle))


def _looks(item: Item) -> tuple[Any, ...]:
    return item.shape, item.size


def _solid(
    scene: viser.SceneApi, name: str, shape: str, size: Numbers, color: Color,
    **place: Any,
) -> Any:
    """Draw an obstacle of some full extents (3,) [m]."""
    if shape == BOX:
        return scene.add_box(name, color, dimensions=(size[0], size[1], size[2]),
                             opacity=_OPACITY, **place)
    if shape == CYLINDER:
        return scene.add_cylinder(name, 0.5 * size[0], size[2], color, opacity=_OPACITY, **place)
    if shape == CAPSULE:
        vertices, triangles = capsule_surface(0.5 * size[0], max(size[2] - size[0], 0.0))
        return scene.add_mesh_simple(name, vertices, triangles, color=color, opacity=_OPACITY,
                                     **place)
    return scene.add_icosphere(name, 0.5, color, subdivisions=3, opacity=_OPACITY,
                               scale=(size[0], size[1], size[2]), **place)


def moved(item: Item, place: Numbers, now: float) -> Item:
    """Return an item whose middle is dragged to a place (3,), with its way if it moves."""
    off = tuple(p - m for p, m in zip(item.place(now), item.position))
    return replace(item, position=tuple(p - o for p, o in zip(place, off)))
