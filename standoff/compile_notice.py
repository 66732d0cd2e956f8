"""Says when numerical code is compiled: what takes so long is never a riddle.

A command says so on stderr; a call from Python to the log of ``standoff``, which Python shows there
unless a program has other plans. Set-up compiles what the commands use (``standoff.warm_up``).
Where that was not possible, as from a wheel, or the folder of the cache cannot be written, the
first use compiles it.
"""

import gc
import logging
import sys
import time
from collections.abc import Callable
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any

_EVENTS = "numba.core.event"
_SENTENCE = "compiling the numerical code, once: up to a minute"
_BETWEEN_S = 1.0
"""Functions follow each other within this time while one measurement waits for all of them."""

_has_teller = False


class _AfterImport(MetaPathFinder):
    """Calls a function with numba's module of events once that is loaded, which most need not."""

    def __init__(self, then: Callable[[ModuleType], None]) -> None:
        self._then = then

    def find_spec(self, fullname: str, _path: Any, _target: Any = None) -> ModuleSpec | None:  # noqa: ANN401 - importlib's
        if fullname != _EVENTS:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def and_then(module: ModuleType) -> None:
                execute(module)
                self._then(module)

            spec.loader.exec_module = and_then  # type: ignore[method-assign]
        return spec


def when_compiling(tell: Callable[[str], None], ended: Callable[[], None] = lambda: None) -> None:
    """Call ``tell`` with the name of each function that is compiled from here on, then ``ended``.

    What the cache has is not compiled. Nothing is imported: numba takes a quarter of a second.
    Python's collector rests meanwhile: it would look through millions of objects that stay.
    """

    def listen(events: Any) -> None:  # noqa: ANN401 - numba has no types
        class Listener(events.Listener):  # type: ignore[misc]
            depth, collects = 0, False

            def on_start(self, event: Any) -> None:  # noqa: ANN401
                if self.depth == 0:
                    self.collects = gc.isenabled()
                    gc.disable()
                self.depth += 1
                tell(event.data["dispatcher"].py_func.__qualname__)

            def on_end(self, event: Any) -> None:  # noqa: ANN401
                self.depth -= 1
                ended()
                if self.depth == 0 and self.collects:
                    gc.enable()

        events.register("numba:compile", Listener())

    if _EVENTS in sys.modules:
        listen(sys.modules[_EVENTS])
    else:
        sys.meta_path.insert(0, _AfterImport(listen))


def announce_compiling(tell: Callable[[str], None] | None = None) -> None:
    """Say in one line, at the first function of many, why nothing happens for a while.

    Who comes first in a process is told; later calls do nothing.

    Parameters
    ----------
    tell
        Takes the line; by default the log.
    """
    global _has_teller
    if _has_teller:
        return
    _has_teller = True
    is_said = False

    def say(_function: str) -> None:
        nonlocal is_said
        if not is_said:
            is_said = True
            (tell or logging.getLogger("standoff").warning)(_SENTENCE)

    when_compiling(say)


class CompileWatch:
    """Whether this process is compiling, for whoever shows that something takes long.

    Parameters
    ----------
    clock
        Gives the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._depth = 0
        self._ended_s = float("-inf")

    def start(self) -> None:
        """Watch from here on."""
        when_compiling(self._begin, self._end)

    @property
    def is_compiling(self) -> bool:
        """Whether a function is being compiled, or was just now."""
        return self._depth > 0 or self._clock() - self._ended_s < _BETWEEN_S

    def _begin(self, _function: str) -> None:
        self._depth += 1

    def _end(self) -> None:
        self._depth -= 1
        self._ended_s = self._clock()
