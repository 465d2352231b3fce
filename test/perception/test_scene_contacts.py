"""MoveIt's allowed collision matrix as the planner's allowed_contacts."""

from __future__ import annotations

import itertools

from conftest import make_panda
import numpy as np
import pytest
import scene_messages as m

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles.contacts import AllowedContacts
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.perception.scene_contacts import allowed_contacts, matrix_of, MOST_ENTRIES
from redundant_planner.perception.scene_records import HeldObject

PANDA = make_panda()
LINKS = sorted({c.frame for c in itertools.compress(PANDA.capsules, PANDA.moved)})


def attached(link, *touch_links):
    return HeldObject(link, np.eye(4), (), touch_links)


def entries(matrix, things, held=None):
    found = allowed_contacts(matrix and matrix_of(matrix), things, held or {}, PANDA)
    # The planner takes every one of them.
    AllowedContacts(found.entries, PANDA.holding(
        [Obstacle.box(f'{name}/0', np.zeros(3), np.full(3, 0.1)) for name in held or {}]))
    return found


def test_pairs_of_a_link_and_an_object_are_handed_on():
    found = entries(m.matrix(['panda_hand', 'panda_link7', 'cup', 'table'],
                             [('panda_hand', 'cup'), ('table', 'panda_link7')]), ['cup', 'table'])
    assert found.entries == ('panda_hand:cup', 'panda_link7:table') and not found.remarks


@pytest.mark.parametrize(('defaults', 'allowed'), [
    ([('cup', True)], True), ([('cup', False)], False),
    ([('cup', True), *((link, False) for link in LINKS)], False),
    ([('cup', True), *((link, True) for link in LINKS)], True)])
def test_defaults_count_where_the_matrix_says_nothing(defaults, allowed):
    """Where both have one, both must allow it; what the matrix says comes first."""
    found = entries(m.matrix(['panda_hand', 'table'], [], defaults), ['cup'])
    assert found.entries == tuple(f'{link}:cup' for link in LINKS if allowed)
    named = entries(m.matrix(['cup', *LINKS], [], [('cup', True)]), ['cup'])
    assert named.entries == ()


def test_what_is_held_may_touch_what_it_stands_on():
    matrix = m.matrix(['cup', 'table'], [('cup', 'table')])
    found = entries(matrix, ['table'], {'cup': attached('panda_hand')})
    assert found.entries == ('attached/cup:table',)


def test_touch_links_that_move_with_the_tip_need_nothing_and_others_are_named():
    held = {'cup': attached('panda_hand', 'panda_leftfinger', 'panda_link7', 'panda_link5')}
    found = entries(None, [], held)
    assert found.entries == () and len(found.remarks) == 1
    assert "keeps it from 'panda_link5' all the same" in found.remarks[0]


def test_what_is_attached_to_the_base_may_touch_its_touch_links():
    found = entries(None, ['plate'], {'plate': attached('panda_link0', 'panda_link2')})
    assert found.entries == ('panda_link2:plate',)


def test_what_an_entry_cannot_say_is_named():
    matrix = m.matrix(['panda_hand', 'cup', ''], [('panda_hand', 'cup'), ('panda_hand', '')])
    found = entries(matrix, ['cup', 'cup/lid', ''])
    assert found.entries == ()
    assert "may touch 'panda_hand', which allowed_contacts cannot say: the object has no" in (
        found.remarks[0])
    assert "it would allow 'cup/lid', too" in found.remarks[1]


def test_own_links_that_the_planner_keeps_apart_all_the_same_are_named():
    frames = [capsule.frame for capsule in PANDA.capsules]
    pair = tuple(frames[i] for i in PANDA.self_pairs[0])
    found = entries(m.matrix(pair, [pair]), [])
    assert found.remarks == ('pairs of own links that may touch are not handed on: the planner '
                             f"keeps '{pair[0]}:{pair[1]}' apart all the same",)


def test_no_more_entries_than_the_planner_can_compare():
    things = [f'thing {i:03}' for i in range(100)]
    found = entries(m.matrix([], [], [(thing, True) for thing in things]), things)
    assert len(found.entries) == MOST_ENTRIES
    assert f'{MOST_ENTRIES} of {100 * len(LINKS)} are handed on' in found.remarks[0]


@pytest.mark.parametrize('message', [
    m.Message(entry_names=['a', 'b'], default_entry_names=[], default_entry_values=[],
              entry_values=[m.Message(enabled=[True, True]), m.Message(enabled=[True])]),
    m.Message(entry_names=[], entry_values=[], default_entry_names=['a'],
              default_entry_values=[])])
def test_lists_of_lengths_that_do_not_fit_are_refused(message):
    with pytest.raises(ObstacleError, match='it takes'):
        matrix_of(message)
