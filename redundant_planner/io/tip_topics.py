"""What the topics of a body with several tips are called, and which one somebody means."""

from __future__ import annotations

from collections.abc import Sequence

from redundant_planner.core.errors import known, StateError

# What coupled tips hold: the name of its topics and of its frame.
OBJECT = 'object'
# What each of several tips hears, and what they hold.
OF_TIPS = ('cmd_vel', 'target_pose', 'target_path')
# Where the planner says where that is, while the tips hold it.
OBJECT_POSE = f'{OBJECT}/pose'


def topic_of(tip: str, name: str, tips: Sequence[str]) -> str:
    """Return a topic of a tip's, or of what the tips hold.

    Args:
        tip: which, or `OBJECT`; empty for the only one.
        name: of the topic for an arm with one tip, as 'cmd_vel'.
        tips: the planner's.

    Raises:
        StateError: there is no such tip, or it takes one to be named.
    """
    if len(tips) == 1 and tip in ('', tips[0]):
        return name
    choice = f'the tips are {known(tips)}, and {OBJECT!r} is what they hold together'
    if len(tips) == 1:
        raise StateError(f"--tip is '{tip}'; the planner has one tip, '{tips[0]}'")
    if not tip:
        raise StateError(f'the planner has several tips: say which with --tip; {choice}')
    if tip not in (*tips, OBJECT):
        raise StateError(f"--tip is '{tip}'; {choice}")
    return f'{tip}/{name}'
