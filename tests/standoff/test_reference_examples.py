"""The examples of the docstrings give what they say, and every public function has one."""

import ast
import doctest
import inspect
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import standoff
from scripts.library_reference import TYPES

ROOT = Path(__file__).parents[2]
PACKAGES = ("acquisition", "calibration", "simulation", "analysis", "hil_mocks", "standoff")
NOT_RUN = {
    "standoff/library/bench/_devices.py: find_cameras": "searches every network of this computer",
    "analysis/pose/_tracker.py: PoseTracker": "needs a camera that delivers frames",
    "analysis/detectors/learned/_weights.py: load_learned": "needs PyTorch and a trained detector",
}


def documented() -> Iterator[tuple[str, str, int]]:
    """Place, docstring and line of everything that has an example."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            if ">>>" not in text:
                continue
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.FunctionDef | ast.ClassDef):
                    about = ast.get_docstring(node)
                    if about is not None and ">>> " in about:
                        name = f"{path.relative_to(ROOT).as_posix()}: {node.name}"
                        yield name, about, node.lineno


def examples() -> dict[str, doctest.DocTest]:
    parser = doctest.DocTestParser()
    return {
        f"{name}:{line}": parser.get_doctest(about, {"standoff": standoff}, name, name, line)
        for name, about, line in documented()
    }


@pytest.mark.parametrize("name", sorted(set(dir(standoff)) - set(TYPES) - {"__version__"}))
def test_what_is_public_has_an_example(name: str) -> None:
    about = inspect.getdoc(getattr(standoff, name)) or ""
    assert "\nExamples\n--------\n" in about


def test_only_what_cannot_be_run_is_left_out() -> None:
    skipped = {
        test.name
        for test in examples().values()
        if any(doctest.SKIP in example.options for example in test.examples)
    }
    assert skipped == set(NOT_RUN)


@pytest.mark.slow
def test_the_examples_give_what_they_say(
    example_files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    runner = doctest.DocTestRunner(verbose=False)
    tests = examples()
    assert len(tests) > 70
    for number, test in enumerate(tests.values()):
        folder = tmp_path / str(number)
        shutil.copytree(example_files, folder)
        with monkeypatch.context() as here:
            here.chdir(folder)
            here.syspath_prepend(folder)  # a detector of the example's own
            runner.run(test, out=told.append)
        sys.modules.pop("my_module", None)
        shutil.rmtree(folder)
    assert not told, "".join(told)
