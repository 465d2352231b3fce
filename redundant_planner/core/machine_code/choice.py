"""By which means this process compiles: Numba's insides, where they are as they were tried."""

from __future__ import annotations

import re
import sys

import numba

from redundant_planner.core.machine_code.means import Means
from redundant_planner.core.machine_code.plain_numba import PLAIN

# The lowest and the highest version of Numba whose insides CI has tried. setup.py, package.xml,
# the README and the Dockerfile name the same.
LOWEST, HIGHEST = (0, 59), (0, 68)


def chosen_means() -> Means:
    """Return the means, and say so in one line where they are not the usual ones."""
    trouble = untested(numba.__version__) or _failed()
    if trouble is None:
        from redundant_planner.core.machine_code.numba_internals import INTERNALS
        return INTERNALS
    print(f'redundant_planner: {trouble}; so functions are compiled plainly, and a tick takes '
          f'about 1.6 times as long; tried are {_name(LOWEST)} to {_name(HIGHEST)}: '
          f"pip install 'numba>={_name(LOWEST)},<{_name((HIGHEST[0], HIGHEST[1] + 1))}'",
          file=sys.stderr, flush=True)
    return PLAIN


def untested(version: str) -> str | None:
    """Return a complaint about a version that CI has not run."""
    numbers = tuple(int(number) for number in re.findall(r'\d+', version)[:2])
    if LOWEST <= numbers <= HIGHEST:
        return None
    return f'Numba {version} has not been tried'


def _failed() -> str | None:
    """Return a complaint if Numba's insides do not do what is expected of them."""
    try:
        # Whatever has changed in Numba shows while these are imported.
        from redundant_planner.core.machine_code import trial
        trial.check()
    except Exception as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        return f'Numba {numba.__version__} has changed inside ({type(error).__name__}: {reason})'
    return None


def _name(version: tuple[int, int]) -> str:
    return '.'.join(str(number) for number in version)
