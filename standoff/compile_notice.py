"""Says when numerical code is compiled: what takes so long is never a riddle.

A command says so on stderr; a call from Python to the log of ``standoff``, which Python shows there
unless a program has other plans. Set-up compiles what the commands use (``standoff.warm_up``).
Where that was not possible, as from a wheel, or the folder of the cache cannot be written, the
first use compiles it.
"""

import gc
import logging
import sys
from collections.abc import Callable
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any

_EVENTS = "numba.core.event"
_SENTENCE = "compiling the numerical code, once: up to a minute"
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


def when_compiling(tell: Callable[[str], None]) -> None:
    """Call ``tell`` with the name of each function that is compiled from here on.

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
