"""The twist that keys, a gamepad and sliders ask for, as long as somebody holds them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# A browser's name of a key (its place on a US keyboard) → axis of the twist, and direction.
KEYS = {
    'KeyW': (0, 1.0), 'KeyS': (0, -1.0), 'KeyA': (1, 1.0), 'KeyD': (1, -1.0),
    'KeyQ': (2, 1.0), 'KeyE': (2, -1.0),
    'ArrowLeft': (5, 1.0), 'ArrowRight': (5, -1.0), 'ArrowUp': (4, 1.0), 'ArrowDown': (4, -1.0),
    'KeyR': (3, 1.0), 'KeyF': (3, -1.0),
}
# With this key held the sliders' twist counts; with this one keys are slower.
SLIDERS_KEY, SLOW_KEY = 'Space', 'ShiftLeft'
SLOWER = 0.25
# Of a gamepad in the browser's standard layout: the buttons of which one is held to drive, the
# one that is held to turn, and how far off its middle a stick counts.
DEAD_MAN_BUTTONS, TURN_BUTTON, DEAD_ZONE = (4, 5), 0, 0.15
# Who holds something and falls silent for this long has let go [s].
SILENCE = 0.4
# How long the command is zero after that, before nothing is commanded [s].
FADING = 0.5
# The fastest that a page drives [m/s, rad/s].
FASTEST_LINEAR, FASTEST_ANGULAR = 0.5, 1.5


@dataclass(frozen=True)
class Speeds:
    """How fast keys and sticks move the tip.

    Attributes:
        linear: [m/s].
        angular: [rad/s].
    """

    linear: float = 0.15
    angular: float = 0.5

    @property
    def twist(self) -> Array:
        """(6,) that all axes at once stand for."""
        return np.repeat((min(max(self.linear, 0.0), FASTEST_LINEAR),
                          min(max(self.angular, 0.0), FASTEST_ANGULAR)), 3)


@dataclass(frozen=True)
class Held:
    """What the driver holds.

    Attributes:
        at: the driver held it at this moment or later, by the monotonic clock [s].
        keys: a browser's names of them.
        axes: of a gamepad, −1 to 1; empty without one.
        buttons: of it, whether each is pressed.
    """

    at: float = -math.inf
    keys: frozenset[str] = frozenset()
    axes: tuple[float, ...] = ()
    buttons: tuple[bool, ...] = ()


def twist_of(held: Held, speeds: Speeds, sliders: Array) -> Array | None:
    """Return the twist (6,) that all that is held asks for; None if nothing is held.

    Args:
        held: by the driver.
        speeds: of keys and sticks.
        sliders: (6,) twist that counts while its key is held.
    """
    if not held.keys and not held.buttons:
        return None
    wanted = twist_of_keys(held.keys, speeds) + twist_of_gamepad(held.axes, held.buttons, speeds)
    return wanted + sliders if SLIDERS_KEY in held.keys else wanted


def twist_of_keys(held: Collection[str], speeds: Speeds) -> Array:
    """Return the twist (6,) that held keys ask for, in the planner's command frame."""
    wanted = np.zeros(6)
    for key in held:
        if key in KEYS:
            axis, direction = KEYS[key]
            wanted[axis] += direction
    return wanted * speeds.twist * (SLOWER if SLOW_KEY in held else 1.0)


def twist_of_gamepad(axes: Sequence[float], buttons: Sequence[bool], speeds: Speeds) -> Array:
    """Return the twist (6,) that a gamepad asks for; zero while no dead-man button is held.

    The left stick moves along x and y, the right one along z and turns about it. With the turn
    button the left stick turns about y and x.
    """
    def pressed(number: int) -> bool:
        return number < len(buttons) and bool(buttons[number])

    if not any(map(pressed, DEAD_MAN_BUTTONS)):
        return np.zeros(6)
    sticks = np.zeros(4)
    sticks[:min(len(axes), 4)] = axes[:4]
    sticks = np.nan_to_num(np.clip(sticks, -1.0, 1.0), nan=0.0)
    beyond = np.maximum(np.abs(sticks) - DEAD_ZONE, 0.0) / (1.0 - DEAD_ZONE)
    left_x, left_y, right_x, right_y = (np.copysign(beyond, -sticks) + 0.0).tolist()
    if pressed(TURN_BUTTON):
        return np.array((0.0, 0.0, right_y, -left_x, left_y, right_x)) * speeds.twist
    return np.array((left_y, left_x, right_y, 0.0, 0.0, right_x)) * speeds.twist


class DeadMan:
    """Commands what is held, and stops when it has been let go of.

    Nothing is commanded while nobody drives: a target, or another sender, has the arm.
    """

    def __init__(self) -> None:
        """Begin with nothing held."""
        self._held: Array | None = None
        self._at = self._let_go = -math.inf

    def hold(self, twist: Array, at: float) -> None:
        """Note that something was held at a moment, and what it asks for (6,).

        It counts as held for `SILENCE` from then on.

        A twist that is not finite counts as zero, a fast one as the fastest.
        """
        fastest = np.repeat((FASTEST_LINEAR, FASTEST_ANGULAR), 3)
        sound = np.asarray(twist, dtype=float)
        if not np.isfinite(sound).all():
            sound = np.zeros(6)
        self._held, self._at = np.clip(sound, -fastest, fastest), at

    def let_go(self, now: float) -> None:
        """Note that nothing is held any more."""
        if self._held is not None:
            self.stop(now)

    def stop(self, now: float) -> None:
        """Let go of all, and command zero for a while, also where nothing was held."""
        self._held, self._let_go = None, now

    def twist(self, now: float) -> Array | None:
        """Return what to command (6,): zero for a while after all was let go, then nothing."""
        if now - self._at > SILENCE:
            self.let_go(now)
        if self._held is not None:
            return self._held
        return np.zeros(6) if now - self._let_go < FADING else None
