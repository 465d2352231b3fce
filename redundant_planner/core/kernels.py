"""Machine code for what runs in every tick (Numba).

A tick is some thousand additions and multiplications on arrays of a few numbers. NumPy takes a
microsecond for each call on them; compiled, all of them together take little more. The functions
that are marked here are plain Python, compiled when their module is first imported. The machine
code is kept, so later starts only load it. `NUMBA_DISABLE_JIT=1` runs the same code as Python,
for a debugger.

Argument types come from the annotations, once: a type that only turned up later would stop the
control loop while it is being compiled. A wrong one is a TypeError instead.

Compiled functions use some of Numba's insides (`machine_code/numba_internals.py`). Where these
are not as they were tried, the functions are compiled without them: slower, with the same results.

An array that Python makes and a function fills takes 0.15 µs, one that a function returns 0.35 µs.
So what runs in every tick fills its results.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba
import numpy as np
import numpy.typing as npt

from redundant_planner.core.machine_code.choice import chosen_means
from redundant_planner.core.machine_code.compiling import (
    compile_called,
    compile_entry,
    compile_inlined,
)

# Arrays of 1, 2, 3 and 4 dimensions. As arguments in any order and read-only or not; as fields
# of a NamedTuple C-ordered and writeable.
Vector = npt.NDArray[np.float64]
Matrix = npt.NDArray[np.float64]
Stack = npt.NDArray[np.float64]
Stacks = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
IndexPairs = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]
FlagMatrix = npt.NDArray[np.bool_]
# Arguments that the function fills.
OutVector = npt.NDArray[np.float64]
OutMatrix = npt.NDArray[np.float64]
OutStack = npt.NDArray[np.float64]

_Function = TypeVar('_Function', bound=Callable[..., object])

# None: everything stays Python.
_MEANS = None if numba.config.DISABLE_JIT else chosen_means()


def compiled(function: _Function) -> _Function:
    """Compile a function for the argument types that its annotations name.

    They are the names above, float, int, bool, and NamedTuples of these. It borrows its arguments
    (`numba_internals`): those that it returns are copies. Division by zero gives infinity or NaN,
    as in NumPy.
    """
    return function if _MEANS is None else compile_called(function, _MEANS)


def kernel(function: _Function) -> _Function:
    """Compile a function, as `compiled`, into those that call it: only compiled functions can.

    A call of its own would copy the descriptions of all arrays in its arguments and count
    references to them. With the records of a scene that takes 150 ns, more than most functions
    here compute for.
    """
    return function if _MEANS is None else compile_inlined(function, _MEANS)


def entry(function: _Function) -> _Function:
    """Compile a function, as `compiled`, that only Python calls, in every tick.

    Numba takes arrays and numbers over from Python in half the time that NamedTuples of them
    need. All NamedTuples are therefore taken apart on the one side and put together on the
    other. They may be arguments, the result, and fields of either. What is `Packed` crosses over
    in its two arrays.
    """
    return function if _MEANS is None else compile_entry(function, _MEANS)
