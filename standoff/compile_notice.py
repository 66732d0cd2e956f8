"""Says when numerical code is compiled: what takes so long is never a riddle.

Set-up compiles what the commands use (``standoff.warm_up``). Where that was not possible,
as from a wheel, or the folder of the cache cannot be written, the first use compiles it.
"""

import sys
from collections.abc import Callable
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any

_EVENTS = "numba.core.event"


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
    """

    def listen(events: Any) -> None:  # noqa: ANN401 - numba has no types
        class Listener(events.Listener):  # type: ignore[misc]
            def on_start(self, event: Any) -> None:  # noqa: ANN401
                tell(event.data["dispatcher"].py_func.__qualname__)

            def on_end(self, event: Any) -> None:  # noqa: ANN401
                pass

        events.register("numba:compile", Listener())

    if _EVENTS in sys.modules:
        listen(sys.modules[_EVENTS])
    else:
        sys.meta_path.insert(0, _AfterImport(listen))
