"""How numerical code is compiled: what Python calls, and the parts of it.

numba compiles a function when it is first called with arguments of some types. What Python calls
is kept beside its module, so that only the first use waits. A part has no way in from Python, which
takes as long to compile as a short function does, and is no file: whatever calls it contains it.
``benchmarks/speed/compiling.py`` shows what that gains.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys
from numba.extending import register_jitable

Function = TypeVar("Function", bound=Callable[..., Any])

# Stated everywhere: a part without them takes those of its first caller, and is compiled again for
# a caller with others. Divided by 0 is infinity or NaN, as in numpy.
_DEFAULTS: dict[str, Any] = {"error_model": "numpy", "fastmath": False, "no_cfunc_wrapper": True}


def compiled(**options: Any) -> Callable[[Function], Function]:  # noqa: ANN401 - numba's
    """Compile a function that Python calls; numba's ``options``, such as ``fastmath``."""

    def decorate(function: Function) -> Function:
        dispatcher = njit(**_DEFAULTS | options)(function)
        dispatcher._cache = _KeptCode(function)  # type: ignore[no-untyped-call]
        compiled_function: Function = dispatcher
        return compiled_function

    return decorate


class _KeptCode(FunctionCache):
    """What numba keeps, loaded without what only compiling needs, which takes .1 s."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ANN401
        rtsys.initialize(target_context)  # counts references to arrays
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


def compiled_part(**options: Any) -> Callable[[Function], Function]:  # noqa: ANN401 - numba's
    """Compile a function that compiled ones call; Python itself runs it as it stands."""
    decorate: Callable[[Function], Function] = register_jitable(**_DEFAULTS | options)
    return decorate
