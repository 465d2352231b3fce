"""Why an arm cannot get to its target, and what may help, in words for who sent it there."""

from __future__ import annotations

from redundant_planner.io.printable import printable

# What a planner's reason has in it → what may help. The first one that is found counts.
_ADVICE = {
    'no posture has the tip': 'a nearer place, or another orientation (--rpy)',
    'out of its cone': 'a tip that leans less (--rpy), or a wider cone.angle',
    'too near to an obstacle': 'a place further from it, another orientation (--rpy) or a '
                               'target.margin of 0.002, or take it away',
    'too near to': 'another place or orientation (--rpy); look at the capsules with show_robot if '
                   'these links have more room in reality',
    'no way to the target': 'a place in between first, or take away what is in the way',
    'near obstacle': 'target.path: free, which goes around, or take it away',
    'at its limit': 'target.path: free, or another orientation (--rpy)'}


def explained(reason: str) -> str:
    """Return the planner's reason, and what may help."""
    advice = next((words for part, words in _ADVICE.items() if part in reason), '')
    return printable(reason or 'no way has been found yet') + (
        f'; try {advice}' if advice else '')
