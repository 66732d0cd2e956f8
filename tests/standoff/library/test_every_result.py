"""Results of all public functions: exported types, documents that come back, equal copies."""

import copy
import json
import pickle
from collections.abc import Callable, Iterator
from inspect import getattr_static, isfunction, unwrap
from pathlib import Path
from types import FunctionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import standoff
from acquisition.aravis import FoundCamera
from simulation.by_value import ByValue, _is_same
from standoff.errors import REPORTED_ERRORS
from tests.standoff.library.every_result import RESULTS, result_of

OURS = ("acquisition", "analysis", "calibration", "hil_mocks", "simulation", "standoff")
NOT_MADE = {"find_cameras", "train_detector"}
"""What needs a network or PyTorch."""


def public() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Every public function, and every method and property of what is made by hand."""
    for name in dir(standoff):
        found = getattr(standoff, name)
        if isinstance(found, FunctionType):
            yield name, unwrap(found)
        elif isinstance(found, type) and name in MADE_BY_HAND:
            yield name, getattr_static(found, "__init__")
            for member in dir(found):
                one = getattr_static(found, member)
                one = getattr(one, "fget", None) or getattr(one, "__func__", one)
                if isfunction(one) and not member.startswith("_") and module_of(one) in OURS:
                    yield f"{name}.{member}", unwrap(one)


MADE_BY_HAND = {
    *("Bench", "CaptureOptions", "ChangePairsTask", "CurveChoice", "DetectionLimitOptions"),
    *("DetectionTask", "EvaluationTask", "FeatureMatches", "GaussianPsf", "PoseWatch"),
    *("RegistrationHints", "Session", "Spot", "SweepOptions", "TrainingOptions"),
    *("UncertaintyOptions",),
}


def module_of(one: Any) -> str:
    return str(one.__module__).split(".")[0]


def types_in(hint: object) -> Iterator[type]:
    """The classes of ours that an annotation names."""
    if isinstance(hint, list | tuple):
        for one in hint:
            yield from types_in(one)
    yield from types_in(get_args(hint)) if get_args(hint) else ()
    found = get_origin(hint) or hint
    if isinstance(found, type) and module_of(found) in OURS:
        yield found


@pytest.mark.parametrize(("name", "function"), list(public()), ids=[name for name, _ in public()])
def test_every_type_of_a_public_signature_is_exported(
    name: str, function: Callable[..., Any]
) -> None:
    only_checked = {"FoundCamera": FoundCamera, "DataFrame": object}
    hints = get_type_hints(function, localns=only_checked)
    exported = [getattr(standoff, one) for one in dir(standoff)]
    missing = {one.__name__ for hint in hints.values() for one in types_in(hint)}
    missing -= {getattr(one, "__name__", "") for one in exported}
    assert missing == set()
    assert all(one in exported for hint in hints.values() for one in types_in(hint))


def test_every_function_that_gives_something_is_among_the_results() -> None:
    giving = {
        name
        for name in dir(standoff)
        if isinstance(one := getattr(standoff, name), FunctionType)
        if get_type_hints(unwrap(one), localns={"FoundCamera": FoundCamera})["return"]
        is not type(None)
    }
    told_elsewhere = {one for one in giving if one.startswith(("read_", "load_"))} | {
        # Plain numbers, words and arrays.
        *("correct_height", "set_aside_files", "reading", "zoom_out"),
    }
    assert giving - told_elsewhere - NOT_MADE == RESULTS.keys() - {
        *("Bench.capture", "read_change_pairs", "read_image"),
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", RESULTS)
@pytest.mark.parametrize(
    "copied",
    [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))],
    ids=["copy", "deepcopy", "pickle"],
)
def test_a_copy_of_a_result_equals_it(there: Path, name: str, copied: Callable[[Any], Any]) -> None:
    found = result_of(name)
    again = copied(found)
    assert again == found
    if isinstance(found, ByValue):
        assert hash(again) == hash(found)


Made = tuple[Callable[[], Any], Callable[[Path, Any], object], Callable[[Path], Any]]

DOCUMENTS: dict[str, Made] = {
    "psf": (lambda: result_of("calibrate_psf"), standoff.write_psf, standoff.read_psf),
    "geometry": (
        lambda: result_of("calibrate_geometry"),
        standoff.write_geometry,
        standoff.read_geometry,
    ),
    "noise": (
        lambda: standoff.write_noise("n.json", result_of("measure_noise")),
        lambda path, _: standoff.write_noise(path.with_name("n.json"), result_of("measure_noise")),
        lambda path: standoff.read_noise(path.with_name("n.json")),
    ),
    "maps": (
        lambda: result_of("measure_noise").maps,
        lambda path, _: standoff.write_noise(path, result_of("measure_noise")),
        standoff.read_correction,
    ),
    "homography": (
        lambda: standoff.Homography(matrix=result_of("register").matrix, size=(320, 240)),
        standoff.write_homography,
        standoff.read_homography,
    ),
    "curves": (lambda: result_of("d_prime_curves"), standoff.write_curves, standoff.read_curves),
    "measured curves": (
        lambda: result_of("measure_curves").curves,
        lambda path, _: result_of("measure_curves").write(path),
        standoff.read_curves,
    ),
    "evaluation": (
        lambda: result_of("evaluate").evaluation,
        lambda path, _: result_of("evaluate").write(path),
        standoff.read_evaluation,
    ),
    "changes": (
        lambda: result_of("find_changes").summary,
        lambda path, _: result_of("find_changes").write(path.parent / "found"),
        lambda path: standoff.read_changes(path.parent / "found" / "changes.json"),
    ),
    "study": (lambda: result_of("plan_study"), standoff.write_study, standoff.read_study),
    "validation": (
        lambda: result_of("validate"),
        lambda path, found: found.write(path),
        standoff.read_validation,
    ),
    "scores": (
        lambda: result_of("score_benchmark").scores,
        lambda path, _: result_of("score_benchmark").write(path.parent / "scores"),
        lambda path: standoff.read_scores(path.parent / "scores" / "scores.json"),
    ),
    "pose": (
        lambda: result_of("judge_pose").summary,
        lambda path, _: path.write_text(json.dumps(result_of("judge_pose").to_json())),
        standoff.read_pose,
    ),
    "series of changes": (
        lambda: standoff.read_changes_series(result_of("find_changes_of_series").summary),
        lambda path, found: found.write(path),
        standoff.read_changes_series,
    ),
    "time line": (
        lambda: standoff.read_time_line(Path("changes/series.json")),
        lambda path, found: found.write(path),
        standoff.read_time_line,
    ),
    "series of poses": (
        lambda: standoff.read_pose_series(result_of("judge_poses").summary),
        lambda path, found: found.write(path),
        standoff.read_pose_series,
    ),
}
"""Of each document: what makes it, what writes it and what reads it."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", DOCUMENTS)
def test_what_is_written_is_read_again_and_equals_it(
    there: Path, tmp_path: Path, kind: str
) -> None:
    make, write, read = DOCUMENTS[kind]
    found, path = make(), tmp_path / "document.json"
    write(path, found)
    assert read(path) == found
    assert found == read(path)
    assert read(path) == copy.deepcopy(read(path)) == pickle.loads(pickle.dumps(read(path)))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [name for name in dir(standoff) if name.startswith("read_")],
)
def test_a_reader_refuses_other_files_in_a_line_and_ignores_what_later_versions_add(
    there: Path, tmp_path: Path, name: str
) -> None:
    read = getattr(standoff, name)
    other = tmp_path / "other.json"
    for content in ("", "[]", "{}", '{"schema": "standoff.later/9"}', "\x00\x01", "[" * 9999):
        other.write_text(content, encoding="utf-8")
        with pytest.raises(REPORTED_ERRORS) as refused:
            read(other)
        assert "other.json" in str(refused.value)
        assert "\n" not in str(refused.value)
    with pytest.raises(REPORTED_ERRORS):
        read(tmp_path / "missing.json")
    with pytest.raises(standoff.ArgumentError):
        read("")


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [kind for kind in DOCUMENTS if kind not in ("noise", "maps", "changes", "scores")]
)
def test_what_later_versions_add_is_ignored(there: Path, tmp_path: Path, kind: str) -> None:
    make, write, read = DOCUMENTS[kind]
    found, path = make(), tmp_path / "document.json"
    write(path, found)
    document = json.loads(path.read_text("utf-8"))
    path.write_text(json.dumps({"later": {"a": [1]}} | document), encoding="utf-8")
    assert read(path) == found


@pytest.mark.slow
def test_what_differs_is_not_equal(there: Path) -> None:
    psf, photograph = result_of("calibrate_psf"), result_of("read_image")
    assert psf != psf.model_copy(update={"rho": 0.5})
    assert psf == psf.model_copy(update={"notes": ("another",)})  # no file has them
    assert psf.edges[0] != psf.edges[1]
    assert photograph != standoff.read_image("after.tif")
    assert photograph != "before.tif"
    assert result_of("simulate") != result_of("simulate_pose")
    pose = standoff.Homography(matrix=np.eye(3), size=(4, 3))
    assert pose == standoff.Homography(matrix=np.eye(3), size=(4, 3))
    assert pose != standoff.Homography(matrix=np.diag([1, 1.5, 1]), size=(4, 3))


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        (np.array([1.0, np.nan]), np.array([1.0, np.nan]), True),
        (np.array([1.0, 2.0]), np.array([1.0, np.nan]), False),
        (np.ones(2), np.ones(3), False),
        (np.ones(2), [1.0, 1.0], False),
        (float("nan"), float("nan"), True),
        (float("nan"), 1.0, False),
        ((1, np.ones(2)), (1, np.ones(2)), True),
        ((1,), [1], False),
        ({"a": np.ones(2)}, {"a": np.ones(2)}, True),
        ({"a": 1}, {"b": 1}, False),
        (None, 0, False),
    ],
)
def test_values_are_the_same_where_they_say_the_same(
    first: object, second: object, same: bool
) -> None:
    assert _is_same(first, second) is same
    assert _is_same(second, first) is same
