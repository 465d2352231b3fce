"""Points are counted in the cubes that they lie in."""

from __future__ import annotations

from hypothesis import given, strategies as st
import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.perception.voxel_grid import centers_of, counted, cropped, key_of

SIZES = (0.005, 0.02, 0.025, 1.0)


@pytest.mark.parametrize('size', SIZES)
@pytest.mark.parametrize('spread', [0.01, 1.0, 60.0])
def test_every_point_is_counted_in_its_voxel(size, spread):
    points = np.random.default_rng(0).normal(0.0, spread, (3, 40_000))
    keys, counts = counted(points, size)
    cells, expected = np.unique(np.floor(points / size), axis=1, return_counts=True)
    assert len(set(keys.tolist())) == len(keys) == cells.shape[1] and counts.sum() == 40_000
    order = np.argsort(keys)  # by x, then y, then z, as np.unique
    np.testing.assert_array_equal(counts[order], expected)
    np.testing.assert_allclose(centers_of(keys[order], size), (cells.T + 0.5) * size, atol=1e-9)


@given(st.lists(st.floats(-100.0, 100.0), min_size=3, max_size=3), st.sampled_from(SIZES))
def test_a_point_lies_in_the_cube_around_its_voxels_centre(point, size):
    keys, counts = counted(np.array(point)[:, None], size)
    assert keys.tolist() == [key_of(point, size)] and counts.tolist() == [1]
    assert (np.abs(centers_of(keys, size)[0] - point) <= 0.5 * size * (1 + 1e-9)).all()


def test_neighbouring_voxels_share_few_slots():
    """A full cube of them, many times what the table begins with."""
    grid = np.stack(np.meshgrid(*3 * [np.arange(-40, 40)]), axis=-1).reshape(-1, 3)
    keys, counts = counted(np.ascontiguousarray((grid.T + 0.5) * 0.02), 0.02)
    assert len(keys) == len(grid) and (counts == 1).all()


def test_no_points_make_no_voxels():
    keys, counts = counted(np.empty((3, 0)), 0.1)
    assert len(keys) == len(counts) == 0 and centers_of(keys, 0.1).shape == (0, 3)


def test_the_crop_keeps_what_lies_in_ball_and_box_and_no_nan():
    random = np.random.default_rng(0)
    points = random.normal(0.0, 1.0, (3, 5000))
    points[:, ::7] = np.nan
    points[1, 3::11] = np.inf
    points[2, 4::13] = -np.inf
    points[0, 5::17] = 1e300
    axes, origin = pin.exp3(np.array([0.3, -0.8, 1.9])), np.array([0.5, -0.2, 0.1])
    ball, box = np.array([0.1, 0.2, 0.3, 1.2]), np.array([[-0.7, -1.0, -0.5], [1.0, 0.9, np.inf]])
    with np.errstate(invalid='ignore', over='ignore'):
        moved = axes @ points + origin[:, None]
        inside = (np.linalg.norm(moved - ball[:3, None], axis=0) <= 1.2) & (
            (moved >= box[0, :, None]) & (moved <= box[1, :, None])).all(axis=0)
    found = np.empty((3, 6000))
    count = cropped(points, origin, axes, ball, box, found)
    assert 500 < count == inside.sum()
    np.testing.assert_allclose(found[:, :count], moved[:, inside], atol=1e-12)
