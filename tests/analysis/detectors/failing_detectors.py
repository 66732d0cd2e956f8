"""Detectors that fail in the way that the reference's first level asks for; copied to a folder.

They stand in a module that knows nothing of this project, as a user's would.
"""

from pathlib import Path

CALLS, EXITS, SEGFAULTS, RAISES, HANGS, NAN, SHAPE, TEXT, INFINITE = range(9)
"""First level of the reference: what a detector is to do. ``CALLS`` is to count."""

MODULE = """
import ctypes
import os
import sys
import time

import numpy as np

calls = 0


def answer(reference, followup, homography):
    global calls
    calls += 1
    kind = int(reference[0, 0])
    print("working on", kind)
    if kind == 1:
        print("no licence", file=sys.stderr)
        os._exit(3)
    if kind == 2:
        print("about to read 0")
        ctypes.string_at(0)
    if kind == 3:
        raise ValueError("bad\\ntiles")
    if kind == 4:
        with open("hung.pid", "w") as file:
            file.write(str(os.getpid()))
        time.sleep(600)
    if kind == 5:
        return float("nan")
    if kind == 6:
        return np.zeros((2, 3))
    if kind == 7:
        return "much"
    if kind == 8:
        return np.full(followup.shape, np.inf)
    return calls


def difference(reference, followup, homography):
    reference -= followup  # what it gets is its own
    return abs(reference)


def channels(reference, followup, homography):
    return float(followup.shape[2] + followup[0, 0, 1] - reference[0, 0, 2])


channels.colour = True


class Nested:
    @staticmethod
    def moment(reference, followup, homography):
        return homography[0, 2]


not_a_function = 3
"""

SCRIPT = """
import os
import struct
import sys
import time

kind, reference, out = sys.argv[1:4]
print("working on", kind, flush=True)
if kind == "exits":
    print("no licence", file=sys.stderr)
    sys.exit(3)
if kind == "aborts":
    os.abort()
if kind == "hangs":
    child = os.fork()
    if child:
        with open("hung.pid", "w") as file:
            file.write(f"{os.getpid()} {child}")
    time.sleep(600)
text = {
    "number": "2.5", "nan": "NaN", "huge": "1e999", "list": "[1]", "true": "true", "prose": "a lot"
}.get(kind)
if kind == "cut":
    with open(reference, "rb") as file, open(out, "wb") as answer:
        answer.write(file.read()[:200])
if kind == "whole":
    with open(reference, "rb") as file, open(out, "wb") as answer:
        answer.write(file.read())
if text is not None:
    with open(out, "w") as file:
        file.write(text)
if kind == "folder":
    os.mkdir(out)
"""


def put_module(folder: Path) -> None:
    """Write the module ``failing`` and the script ``failing_command.py``."""
    (folder / "failing.py").write_text(MODULE)
    (folder / "failing_command.py").write_text(SCRIPT)
