"""Ways to spoil text, numbers and trees of values."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

NUMBERS = ('nan', 'inf', '-inf', '1e308', '-1e308', '1e-308', '0', '-0.0', '-1', '', 'abc', '-90°',
           '1e5', '0x10', '1,5', '1 2', '1_0', '٣', '9' * 400, '1e400', '--1', 'None')
VALUES = (None, True, False, 0, -1, 1e308, -1e308, 1e-308, float('nan'), float('inf'), 10**400, '',
          'abc', 'nan', '\x00', 'ü' * 300, [], {}, [[]], [None], [1, 2], [1.0] * 4, ['a', 'b'],
          {'a': 1}, {1: 2}, {'': {}}, [[0.0] * 3] * 3, 'package://nowhere/x', '~nobody/x',
          'x' * 5000, '/dev/null', '..')
WORDS = ('<', '>', '"', '&', '&#0;', '{', '}', '[', ']', ':', '- ', '\t', '\n', '*a', '&a ', '!!',
         '\ufeff', '\u202e', '\ud7ff', '\x00', '<!--', ']]>', '%', '|', '2001-99-99')
_NUMBER = re.compile(r'(?<![\w.])[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?(?![\w.])')


def pick(random: np.random.Generator, choices: Any) -> Any:
    """Return one of the choices, as it is."""
    return choices[int(random.integers(len(choices)))]


def spoilt_bytes(random: np.random.Generator, content: bytes) -> bytes:
    """Flip bits, cut, repeat or insert."""
    for _ in range(int(random.integers(1, 6))):
        place, end = np.sort(random.integers(0, len(content) + 1, 2))
        kind = random.integers(4)
        if kind == 0 and place < len(content):
            flipped = content[place] ^ (1 << int(random.integers(8)))
            content = content[:place] + bytes([flipped]) + content[place + 1:]
        elif kind == 1:
            content = content[:place] + content[end:] if random.random() < 0.5 else content[:end]
        elif kind == 2:
            content = content[:end] + content[place:min(end, place + 2000)] + content[end:]
        else:
            content = content[:place] + pick(random, WORDS).encode() + content[place:]
    return content


def spoilt_numbers(random: np.random.Generator, text: str) -> str:
    """Replace up to three numbers of a text."""
    for _ in range(int(random.integers(1, 4))):
        found = list(_NUMBER.finditer(text))
        if found:
            match = pick(random, found)
            text = text[:match.start()] + pick(random, NUMBERS) + text[match.end():]
    return text


def spoilt_tree(random: np.random.Generator, tree: Any) -> Any:
    """Replace, remove, rename or repeat something somewhere in nested lists and mappings."""
    if not isinstance(tree, (dict, list)) or not tree or random.random() < 0.1:
        return pick(random, VALUES)
    if isinstance(tree, list):
        tree = list(tree)
        i = int(random.integers(len(tree)))
        if random.random() < 0.2:
            tree[i:i + 1] = [tree[i]] * int(pick(random, (0, 2, 50)))
        else:
            tree[i] = spoilt_tree(random, tree[i])
        return tree
    tree = dict(tree)
    key = pick(random, list(tree))
    chance = random.random()
    if chance < 0.1:
        del tree[key]
    elif chance < 0.2:
        other = pick(random, (f'{key}x', str(key)[1:], '', 7, None, str(key).upper()))
        tree[other] = tree.pop(key)
    else:
        tree[key] = spoilt_tree(random, tree[key])
    return tree
