"""What is read of serialised messages has bounds, whatever the bytes say."""

from __future__ import annotations

from hypothesis import given, strategies as st
import pytest

from redundant_planner.core.errors import StateError
from redundant_planner.io.cdr import byte_order, LARGEST_MESSAGE, LONGEST_NAME, text


@given(st.text(max_size=LONGEST_NAME).filter(lambda name: len(name.encode()) <= LONGEST_NAME),
       st.binary(max_size=20))
def test_a_name_is_read_as_it_was_written(name, before):
    raw = before + name.encode() + b'\0'
    assert text(raw, len(before), len(name.encode()) + 1) == name
    if name:
        with pytest.raises(StateError, match='the bytes end within a name'):
            text(raw, len(before), len(name.encode()) + 2)


def test_names_have_a_longest():
    raw = b'a' * (LONGEST_NAME + 1) + b'\0'
    assert text(raw, 1, LONGEST_NAME + 1) == 'a' * LONGEST_NAME
    with pytest.raises(StateError, match='a name in it has 256 bytes; up to 255 are read'):
        text(raw, 0, LONGEST_NAME + 2)


def test_messages_have_a_longest():
    head = b'\0\1\0\0'
    assert byte_order(head + bytes(LARGEST_MESSAGE - 4)) == '<'
    with pytest.raises(StateError, match=f'up to {LARGEST_MESSAGE} are read'):
        byte_order(head + bytes(LARGEST_MESSAGE - 3))
