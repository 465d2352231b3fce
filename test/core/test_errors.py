"""Messages about bad input."""

from __future__ import annotations

from redundant_planner.core.errors import unknown_names

KNOWN = ('look_ahead', 'capsule.link1.radius', 'urdf')


def test_unknown_names_suggest_what_was_probably_meant():
    assert unknown_names(['urdf', 'look_ahead'], KNOWN) == []
    assert unknown_names(['look_aheed', 'urdf', 'capsule.link1.raduis', 'wheels'], KNOWN) == [
        "parameter 'capsule.link1.raduis' is not known; did you mean 'capsule.link1.radius'?",
        "parameter 'look_aheed' is not known; did you mean 'look_ahead'?",
        "parameter 'wheels' is not known"]


def test_many_and_long_unknown_names_still_make_a_short_message():
    sentences = unknown_names([f'{i}{"x" * 10_000}' for i in range(10_000)], KNOWN)
    assert len(sentences) == 13 and sentences[-1] == '9988 more parameters are not known'
    assert all(len(sentence) < 200 for sentence in sentences)
