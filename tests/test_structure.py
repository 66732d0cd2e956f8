"""The floor plan: how large folders, functions and signatures may grow, and who knocks where.

Layers and circles are import-linter's; here is what it does not see.
"""

import ast
import importlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from radon.visitors import ComplexityVisitor

import standoff

ROOT = Path(__file__).parent.parent
PACKAGES = ("acquisition", "calibration", "simulation", "analysis", "hil_mocks", "standoff")
MODULES = [path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))]
ROOMS = [path.parent for path in MODULES if path.name == "__init__.py"]
MODULES_MOST = {"standoff": 24}
MODULES_MOST_ELSEWHERE = 17
LINES_MOST = 700
BODY_LINES_MOST = 60
PARAMETERS_MOST = 6
COMPLEXITY_MOST = 20
"""Radon's rank C ends here, D begins."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def dotted(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text("utf-8"))


def functions(path: Path) -> Iterator[Function]:
    return (node for node in ast.walk(parsed(path)) if isinstance(node, Function))


def body_lines(function: Function) -> int:
    """Lines of a function without its signature and its docstring."""
    body = function.body
    if ast.get_docstring(function) is not None:
        body = body[1:]
    return (function.end_lineno or 0) - body[0].lineno + 1 if body else 0


def parameters(function: Function) -> list[str]:
    asked = function.args
    names = [a.arg for a in (*asked.posonlyargs, *asked.args, *asked.kwonlyargs)]
    return [name for name in names if name not in ("self", "cls")]


def is_compiled(function: Function) -> bool:
    marks = [ast.unparse(mark) for mark in function.decorator_list]
    return any(mark.startswith(("njit", "compiled")) for mark in marks)


def room_of(module: str) -> str:
    """The innermost sub-package that a dotted name lies in."""
    parts = module.split(".")
    while not (ROOT.joinpath(*parts) / "__init__.py").is_file():
        parts.pop()
    return ".".join(parts)


def test_a_folder_holds_no_more_modules_than_one_takes_in_at_a_glance() -> None:
    crowded = {}
    for room in ROOMS:
        modules = [path for path in room.glob("*.py") if path.name != "__init__.py"]
        most = MODULES_MOST.get(room.relative_to(ROOT).parts[0], MODULES_MOST_ELSEWHERE)
        if len(modules) > most:
            crowded[dotted(room)] = len(modules)
    assert crowded == {}


def test_a_room_says_what_it_is_and_what_it_gives() -> None:
    for room in ROOMS:
        module = importlib.import_module(dotted(room))
        assert module.__doc__, dotted(room)
        for name in getattr(module, "__all__", ()):
            assert getattr(module, name) is not None, f"{dotted(room)}.{name}"


def test_a_module_is_read_in_one_sitting() -> None:
    lines = {dotted(path): len(path.read_text("utf-8").splitlines()) for path in MODULES}
    assert {name: count for name, count in lines.items() if count > LINES_MOST} == {}


@pytest.mark.slow
def test_another_room_is_entered_by_its_front_door() -> None:
    assert [entry for path in MODULES for entry in other_entries(path)] == []


def other_entries(path: Path) -> Iterator[str]:
    """Imports from a module of another room; rooms within a room may, if its name is public."""
    own = room_of(dotted(path))
    for node in ast.walk(parsed(path)):
        if not isinstance(node, ast.ImportFrom) or node.module is None:
            continue
        if node.module.split(".")[0] not in PACKAGES:
            continue
        room = room_of(node.module)
        at_home = own == room or own.startswith(f"{room}.")
        at_the_top = "." not in room
        is_private = node.module.rpartition(".")[2].startswith("_")
        if (is_private and own != room) or not (at_home or at_the_top or node.module == room):
            yield f"{dotted(path)}, line {node.lineno}: {node.module}"


@pytest.mark.slow
def test_parts_of_compiled_code_that_take_time_are_not_called_from_python() -> None:
    # Python would run them as they stand, a hundred times slower.
    shared = {name for path in MODULES for name in parts_of(path) if not name.startswith("_")}
    called = {
        name for path in MODULES for name in called_from_python(path) & (shared | parts_of(path))
    }
    assert called == AS_FAST


AS_FAST = {"is_more_likely", "_no_edge", "project", "projection_depth", "projection_slopes"} | {
    "cosine_transform",
    "robust_sigma",
}
"""A few numbers, or numpy's own loops."""


def parts_of(path: Path) -> set[str]:
    """Functions of a module that are compiled as parts of others."""
    return {
        function.name
        for function in functions(path)
        if any("compiled_part" in ast.unparse(mark) for mark in function.decorator_list)
    }


def called_from_python(path: Path) -> set[str]:
    """Names that are used outside compiled functions, and mean what was imported from ours."""
    tree = parsed(path)
    compiled = [each for each in functions(path) if is_compiled(each)]
    inside = {id(node) for each in compiled for node in ast.walk(each)}
    ours = {each.name for each in tree.body if isinstance(each, ast.FunctionDef)} | {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in PACKAGES
        for alias in node.names
    }
    return ours & {
        node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in inside
    }


def test_a_function_fits_on_a_page() -> None:
    long = {
        f"{dotted(path)}.{function.name}": body_lines(function)
        for path in MODULES
        for function in functions(path)
        if body_lines(function) > BODY_LINES_MOST and not is_compiled(function)
    }
    assert long == {}


def is_called_by_people(path: Path, function: Function) -> bool:
    """A command, or the public function or class that takes all of its options."""
    room = path.relative_to(ROOT).parts[:2]
    if room == ("standoff", "library"):
        return function.name in dir(standoff) or function.name == "__init__"
    return room == ("standoff", "commands")


def test_a_function_takes_six_parameters_at_most() -> None:
    greedy = {
        f"{dotted(path)}.{function.name}": len(parameters(function))
        for path in MODULES
        for function in functions(path)
        if len(parameters(function)) > PARAMETERS_MOST and not is_called_by_people(path, function)
    }
    assert greedy == {}


def test_what_is_exported_is_defined_once() -> None:
    exported = set(dir(standoff))
    defined: dict[str, list[str]] = {}
    for path in MODULES:
        if path.relative_to(ROOT).parts[:2] == ("standoff", "commands"):
            continue  # a command has the name of the function that it calls
        for node in parsed(path).body:
            if isinstance(node, ast.FunctionDef) and node.name in exported:
                defined.setdefault(node.name, []).append(dotted(path))
    assert {name: found for name, found in defined.items() if len(found) > 1} == {}


@pytest.mark.slow
def test_no_block_is_of_complexity_d() -> None:
    tangled = {
        f"{dotted(path)}.{block.name}": block.complexity
        for path in MODULES
        for block in ComplexityVisitor.from_ast(parsed(path)).blocks
        if block.complexity > COMPLEXITY_MOST
    }
    assert tangled == {}
