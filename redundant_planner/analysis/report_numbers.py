"""Numbers as a reader takes them in: three digits that count, a true minus sign."""

from __future__ import annotations

import math

# What is less is round-off, in any unit that the report shows.
_NOTHING = 1e-6


def number_text(value: float | None, digits: int = 3) -> str:
    """Return a number with so many significant digits, a dash for one that is not known."""
    if value is None or not math.isfinite(value):
        return '–'
    if abs(value) < _NOTHING:
        return '0'
    places = digits - 1 - math.floor(math.log10(abs(float(f'{value:.{digits - 1}e}'))))
    if places > digits + 3 or places < -6:
        mantissa, _, exponent = f'{value:.{digits - 1}e}'.partition('e')
        return f'{mantissa}·10{_raised(int(exponent))}'.replace('-', '−')
    rounded = round(value, places)
    return f'{rounded:.{max(places, 0)}f}'.replace('-', '−')


def difference_text(base: float, other: float) -> str:
    """Return other − base with its sign, and the change as a share where there is one."""
    change = other - base
    sign = '+' if change > 0.0 else ''
    if not math.isfinite(change):
        return '–'
    if abs(change) < _NOTHING:
        return '±0'
    return f'{sign}{number_text(change)}'


def share_text(base: float, other: float) -> str:
    """Return by how many percent a number changed; a dash where there was nothing."""
    if not math.isfinite(base) or not math.isfinite(other) or abs(base) < 1e-9:
        return '–'
    text = f'{100.0 * (other - base) / abs(base):+.1f}'
    return '±0' if float(text) == 0.0 else text.replace('-', '−')


def _raised(exponent: int) -> str:
    return str(exponent).translate(str.maketrans('0123456789-', '⁰¹²³⁴⁵⁶⁷⁸⁹⁻'))
