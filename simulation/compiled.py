"""How numerical code is compiled: what Python calls, and the parts of it.

numba compiles a function when it is first called with arguments of some types. What Python calls
is kept beside its module, so that only the first use waits. A part has no way in from Python, which
takes as long to compile as a short function does, and is no file: whatever calls it contains it.
``benchmarks/bench_compiling.py`` shows what that gains.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit
from numba.extending import register_jitable

Function = TypeVar("Function", bound=Callable[..., Any])

# Stated everywhere: a part without them takes those of its first caller, and is compiled again for
# a caller with others. Divided by 0 is infinity or NaN, as in numpy.
_DEFAULTS: dict[str, Any] = {"error_model": "numpy", "fastmath": False, "no_cfunc_wrapper": True}


def compiled(**options: Any) -> Callable[[Function], Function]:  # noqa: ANN401 - numba's
    """Compile a function that Python calls; numba's ``options``, such as ``fastmath``."""
    decorate: Callable[[Function], Function] = njit(cache=True, **_DEFAULTS | options)
    return decorate


def compiled_part(**options: Any) -> Callable[[Function], Function]:  # noqa: ANN401 - numba's
    """Compile a function that compiled ones call; Python itself runs it as it stands."""
    decorate: Callable[[Function], Function] = register_jitable(**_DEFAULTS | options)
    return decorate
