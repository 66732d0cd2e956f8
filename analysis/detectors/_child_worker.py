"""Runs a detector in a process of its own; started as a file by `child_host`, never imported.

Requests come on standard input and answers go to standard output; the detector itself reads
nothing, and what it prints goes to standard error. Until it knows where its parent finds modules,
it imports nothing of this project.
"""

import json
import os
import select
import sys
import time
from importlib import import_module
from multiprocessing.connection import Connection
from threading import Thread

_IN_ORDER_S = 1.0
"""For an idle process to end by itself, with what its modules do then."""


def main() -> None:
    """Answer until the parent closes the pipe."""
    requests, answers = Connection(os.dup(0), writable=False), Connection(os.dup(1), readable=False)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr] # it is a file
    Thread(target=_end_with_parent, args=(requests.fileno(),), daemon=True).start()
    told = json.loads(requests.recv_bytes())
    sys.path[:] = told["sys_path"]
    # Ours come before the working folder is looked at: a file there may be called "analysis".
    serve = import_module("analysis.detectors._child_service").serve
    sys.path.insert(0, told["folder"])
    serve(requests, answers, told)


def _end_with_parent(requests: int) -> None:
    """End even in the middle of a detector's work when nobody waits for it any more."""
    hanging_up = select.poll()
    hanging_up.register(requests, 0)
    hanging_up.poll()
    time.sleep(_IN_ORDER_S)
    os._exit(1)


if __name__ == "__main__":
    main()
