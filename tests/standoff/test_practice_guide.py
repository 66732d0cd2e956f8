"""The guide to practising names bench files and plans that are shipped."""

import re
import shlex
from pathlib import Path

import pytest

from tests.standoff.conftest import Command

CHECKOUT = Path(__file__).parents[2]


def test_the_capture_of_the_guide_is_one_that_can_be_planned(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(CHECKOUT)
    text = (CHECKOUT / "docs" / "practice-bench.md").read_text("utf-8")
    (line,) = re.findall(r"^standoff (capture .*)$", text, re.MULTILINE)
    done = command.done(*shlex.split(line), "--dry-run")
    assert "17 captures" in done.out  # of configs/demo_plan.toml: 12 of edges, 5 of the texture
