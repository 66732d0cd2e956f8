"""Compilation is never silent, and nothing is said where the cache has it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from standoff.compile_notice import CompileWatch

PROGRAM = """
from standoff.compile_notice import when_compiling
said = []
when_compiling(said.append)
import sys
assert "numba" not in sys.modules
from simulation.pose._warp import ideal_factors
import numpy as np
ideal_factors(0.1, 0.0, np.zeros(3))
print(",".join(said))
"""


def compiled(cache: Path) -> list[str]:
    """The functions that a process of its own compiles with this folder as its cache."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip().split(",")


@pytest.mark.slow
def test_each_function_is_told_when_it_is_compiled_and_not_when_it_is_loaded(
    tmp_path: Path,
) -> None:
    first = compiled(tmp_path)
    assert "ideal_factors" in first
    assert compiled(tmp_path) == [""]


def test_a_watch_says_compiling_until_no_function_has_followed_for_a_second() -> None:
    now_s = [10.0]
    watch = CompileWatch(lambda: now_s[0])
    assert not watch.is_compiling
    watch._begin("one")
    watch._begin("a part of it")
    watch._end()
    now_s[0] += 30.0
    assert watch.is_compiling
    watch._end()
    now_s[0] += 0.5
    assert watch.is_compiling
    now_s[0] += 1.0
    assert not watch.is_compiling
