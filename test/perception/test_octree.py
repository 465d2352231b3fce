"""Octomaps as OctoMap itself writes them, and trees of our own."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
import pytest
from scene_messages import octomap

from redundant_planner.core.errors import ObstacleError
from redundant_planner.perception.octree import occupied

# What OctoMap 1.10 wrote of a tree with cells of 0.1 m: three occupied cells, two free ones, and
# eight occupied cells that it put together.
BINARY = zlib.decompress(base64.b85decode(
    'c-mw5W59q3nHdf+@BnEB1s(?M5G>8a%zy(PFlJz55MW?p004hY1^f'))
FULL = zlib.decompress(base64.b85decode(
    'c-q^wCBflA^NR?37Lo}@5WxW=nBZa#Ac6rdMkb*EH%b6(-Y%dc87UwdL8h>R2xhQ(@-xrx0~0J@7F-<z0IjBQZv'))
CUBES = [(-0.35, 0.25, 0.75, 0.1), (0.05, 0.05, 0.05, 0.1), (0.5, 0.5, 0.5, 0.2),
         (1.25, -2.05, 0.15, 0.1)]
ALL = 1e6


def cubes(data, binary=True, center=(0.0, 0.0, 0.0), radius=ALL, resolution=0.1):
    found = occupied(octomap(data, resolution, binary).octomap, np.array(center), radius)
    return sorted(map(tuple, np.column_stack([*found]).round(9).tolist()))


@pytest.mark.parametrize(('data', 'binary'), [(BINARY, True), (FULL, False)])
def test_cubes_are_where_octomap_has_them(data, binary):
    assert cubes(data, binary) == CUBES
    signed = np.frombuffer(data, np.int8)  # as rclpy gives an int8[]
    assert cubes(signed, binary) == cubes(signed.tolist(), binary) == CUBES


def test_cubes_beyond_the_ball_are_left_out():
    """A cube counts as soon as its nearest corner is within."""
    assert cubes(BINARY, center=(0.5, 0.5, 0.5), radius=0.2) == [CUBES[2]]
    assert cubes(BINARY, center=(0.7, 0.5, 0.5), radius=0.101) == [CUBES[2]]
    assert cubes(BINARY, center=(0.7, 0.5, 0.5), radius=0.099) == []


def random_tree(rng, depth, low, edge, cells):
    """Bytes of a random inner node in both forms; its occupied cells are appended (cells)."""
    below, codes = [], []
    for i in range(8):
        corner = low + edge // 2 * np.array([i & 1, i >> 1 & 1, i >> 2])
        code = rng.choice(4, p=[0.7, 0.1, 0.1, 0.1]) if depth > 1 else rng.integers(3)
        if depth > 12:
            code = 3 if i == 3 else 0
        elif i == 7 and not any(codes):  # an inner node has children
            code = 1
        codes.append(code)
        if code == 3:
            below.append(random_tree(rng, depth - 1, corner, edge // 2, cells))
        elif code:
            value = rng.uniform(0.0, 3.5) * (1 if code == 2 else -1) - 1e-9 * (code == 1)
            below.append((b'', struct.pack('<fB', value, 0)))
            if code == 2:
                cells.append((*corner, edge // 2))
    pairs = sum(int(code) << 2 * i for i, code in enumerate(codes))
    mask = sum(1 << i for i, code in enumerate(codes) if code)
    return (struct.pack('<H', pairs) + b''.join(part for part, _ in below),
            struct.pack('<fB', 0.4, mask) + b''.join(part for _, part in below))


@pytest.mark.parametrize('seed', range(10))
def test_random_trees_are_read_in_both_forms(seed):
    cells = []
    binary, full = random_tree(np.random.default_rng(seed), 16, np.zeros(3, int), 2**16, cells)
    expected = sorted(tuple(np.round([*(0.05 * (np.array(cell[:3]) - 2**15 + 0.5 * cell[3])),
                                      0.05 * cell[3]], 9).tolist()) for cell in cells)
    assert cubes(binary, True, resolution=0.05) == expected
    assert cubes(full, False, resolution=0.05) == expected


@pytest.mark.parametrize('binary', [True, False])
def test_bytes_that_end_early_or_go_too_deep_are_refused(binary):
    for count in range(1, 90):
        with pytest.raises(ObstacleError, match='end within a node'):
            cubes((BINARY if binary else FULL)[:count], binary)
    with pytest.raises(ObstacleError, match='deeper than 16 levels'):
        cubes(b'\3\0' * 40 if binary else struct.pack('<fB', 1.0, 1) * 40, binary)


def test_an_empty_map_has_no_cubes():
    assert cubes(b'') == []
    # A full tree of one node is all occupied.
    assert cubes(struct.pack('<fB', 1.0, 0), False) == [(0.0, 0.0, 0.0, 6553.6)]
