"""Items are obstacles that move as they say, whatever a page sends."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import ObstacleError
from redundant_planner.io.parameter_files import read_robot_parameters
from redundant_planner.playground.items_view import moved
from redundant_planner.playground.scenes import page_scenes
from redundant_planner.playground.world import (
    checked,
    FAR,
    FASTEST,
    Item,
    ITEM_SHAPES,
    LARGEST,
    MOST_ITEMS,
    SMALLEST,
    World,
)

ANY = st.floats(allow_nan=True, allow_infinity=True)
PLACES, TURNS = (st.tuples(*[ANY] * count) for count in (3, 4))


@given(st.sampled_from(ITEM_SHAPES), PLACES, PLACES, TURNS, PLACES, ANY, st.floats(0.0, 1e4))
def test_an_item_is_a_sound_obstacle_or_is_refused(
        shape, size, position, turn, swing, period, time):
    try:
        item = checked(Item('thing', shape, size, position, turn, swing, period))
    except ObstacleError as error:
        assert "obstacle 'thing'" in str(error) and 'finite' in str(error)
        assert not all(map(np.isfinite, (*size, *position, *turn, *swing, period)))
        return
    obstacle = item.obstacle(time)
    assert (np.abs(item.position) <= FAR).all() and np.abs(obstacle.center).max() <= 2 * FAR
    # A capsule's own length is its size all the same.
    assert (2.0 * obstacle.half_extents >= SMALLEST - 1e-12).all()
    assert (2.0 * obstacle.half_extents <= LARGEST + 1e-12).all()
    assert np.linalg.norm(obstacle.velocity) <= FASTEST * (1.0 + 1e-9)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(0.5, 20.0), st.floats(0.0, 50.0))
def test_its_velocity_is_the_derivative_of_its_way(swing, period, time):
    item = checked(Item('thing', 'box', (0.1, 0.1, 0.1), (0.5, 0.0, 0.5), swing=swing,
                        period=period))
    step = 1e-5
    ahead, behind = (np.array(item.place(time + s)) for s in (step, -step))
    np.testing.assert_allclose(
        item.obstacle(time).velocity, (ahead - behind) / (2.0 * step), atol=1e-5)


def test_a_thing_that_moves_is_dragged_with_its_way():
    item = checked(Item('thing', 'box', (0.1, 0.1, 0.1), (0.5, 0.0, 0.5), swing=(0.2, 0.0, 0.0)))
    there = moved(item, (1.0, 1.0, 1.0), 1.3)
    np.testing.assert_allclose(there.place(1.3), (1.0, 1.0, 1.0))
    assert there.swing == item.swing


def test_names_are_new_and_there_is_an_end():
    world = World()
    assert [world.add('box', (0.5, 0.0, 0.5)) for _ in range(2)] == ['box 1', 'box 2']
    world.remove('box 1')
    assert world.add('box', (0.5, 0.0, 0.5)) == 'box 1'
    for _ in range(MOST_ITEMS - 2):
        world.add('ellipsoid', (0.5, 0.0, 0.5))
    with pytest.raises(ObstacleError, match='the page takes 200: delete some'):
        world.add('box', (0.5, 0.0, 0.5))
    with pytest.raises(ObstacleError, match='it must be one of'):
        World().add('donut', (0.5, 0.0, 0.5))


def test_what_is_refused_changes_nothing():
    world = World([Item('thing', 'box', (0.1, 0.1, 0.1), (0.5, 0.0, 0.5))])
    before = world.items
    with pytest.raises(ObstacleError):
        world.change(replace(before['thing'], position=(np.nan, 0.0, 0.0)))
    world.change(Item('another', 'box', (0.1, 0.1, 0.1), (0.5, 0.0, 0.5)))
    assert world.items is before


def test_every_scene_has_sound_items_and_files_that_are_there():
    scenes = page_scenes(None)
    assert len({scene.title for scene in scenes}) == len(scenes) == 5
    for scene in scenes:
        world = World(scene.items)
        assert len(world.items) == len(scene.items) and scene.hint
        for item in world.items.values():
            item.obstacle(1.0)
        for arm in scene.arms:
            assert arm.start
            for file in (*arm.files, *((arm.robot_file,) if arm.robot_file else ())):
                assert file.is_file()
            if arm.robot_file:
                read_robot_parameters(arm.robot_file)
    assert max(len(scene.arms) for scene in scenes) == 2
