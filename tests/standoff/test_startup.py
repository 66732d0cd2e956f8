"""What a command line imports: nothing that computes, until a command runs."""

import json
import subprocess
import sys

import pytest

from standoff.terminal.app import COMMANDS

COMPUTING = {
    *("PIL", "cv2", "gi", "jinja2", "joblib", "matplotlib", "numba", "numpy", "scipy", "serial"),
    *("skimage", "starlette", "tifffile", "torch", "uvicorn", "weasyprint"),
}
"""Pydantic is not among them: typer itself needs it for the help of a command."""

ALL_HELP = """
import json, sys
from standoff.cli import run
found = {}
for name in json.loads(sys.argv[1]):
    run([name, "--help"])
    found[name] = sorted(sys.modules)
json.dump(found, sys.stderr)
"""


@pytest.mark.slow
def test_the_help_of_no_command_imports_what_computes() -> None:
    words = [sys.executable, "-c", ALL_HELP, json.dumps(list(COMMANDS))]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    imported = json.loads(done.stderr)
    assert {name: COMPUTING & set(modules) for name, modules in imported.items()} == {
        name: set() for name in COMMANDS
    }


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["simulate", "--help"]])
def test_a_process_that_computes_nothing_imports_nothing_for_it(arguments: list[str]) -> None:
    words = [sys.executable, "-X", "importtime", "-m", "standoff", *arguments]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "standoff.cli" in imported
    assert COMPUTING & imported == set()
