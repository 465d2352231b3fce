"""Text from a bag, made fit to be shown."""

from __future__ import annotations

# What is longer is cut: a name is some dozens of characters, a message some hundreds.
_LONGEST = 2000


def printable(text: str, longest: int = _LONGEST) -> str:
    """Return text as one line of printable characters.

    Control characters, which a terminal would obey, are written as their escapes.

    Args:
        text: from anywhere.
        longest: characters that are kept.
    """
    shown = ''.join(
        c if c.isprintable() else ' ' if c in '\n\t' else repr(c)[1:-1] for c in text[:longest])
    return shown if len(text) <= longest else f'{shown} …'
