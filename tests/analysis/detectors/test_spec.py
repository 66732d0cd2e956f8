import pickle
import shlex
import sys
from functools import partial
from pathlib import Path
from threading import Lock

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from analysis.detectors import BUILT_IN_DETECTORS, DetectorSpec
from analysis.detectors.built_in import FUNCTIONS
from analysis.errors import DetectorError
from simulation.arrays import Float32Array, FloatArray


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def missing(text: str) -> str:
    with pytest.raises(DetectorError) as raised:
        DetectorSpec.parse(text)
    assert raised.value.reason == "missing"
    assert "\n" not in str(raised.value)
    return str(raised.value)


def mean_level(reference: Float32Array, followup: Float32Array, homography: FloatArray) -> float:
    return float(np.mean(followup) - np.mean(reference) + homography[0, 2])


def test_every_built_in_name_is_one_of_a_function() -> None:
    assert tuple(FUNCTIONS) == BUILT_IN_DETECTORS
    for name in BUILT_IN_DETECTORS:
        spec = DetectorSpec.parse(name)
        assert (spec.kind, spec.name) == ("built-in", name)


def test_an_unknown_name_is_answered_with_those_that_there_are() -> None:
    text = missing("sism")
    for name in BUILT_IN_DETECTORS:
        assert name in text
    assert "module:function" in text
    assert ".onnx" in text


def test_a_file_that_is_not_there_is_named() -> None:
    assert "nets/siamese.onnx: no such file" in missing("nets/siamese.onnx")


@pytest.mark.parametrize("lacking", ["{reference}", "{followup}", "{out}"])
def test_a_command_without_a_placeholder_says_which(lacking: str) -> None:
    marks = [mark for mark in ("{reference}", "{followup}", "{out}") if mark != lacking]
    assert f"lacks {lacking};" in missing("detect " + " ".join(marks))


def test_a_command_with_an_open_quotation_is_refused() -> None:
    assert "no closing quotation" in missing("detect '{reference} {followup} {out}")


def test_words_without_placeholders_are_a_command_that_lacks_them() -> None:
    assert "lacks {reference} and {followup} and {out}" in missing("python detect.py")


def test_the_identity_changes_with_the_files_and_the_text_alone(folder: Path) -> None:
    (folder / "rooms").mkdir()
    files = {
        "rooms/own.py": "rooms.own:detect",
        "net.onnx": "net.onnx",
        "detect.py": shlex.join([sys.executable, "detect.py", "{reference}"]) + " {followup} {out}",
    }
    for file in files:
        (folder / file).write_text("one")
    before = {file: DetectorSpec.parse(text) for file, text in files.items()}
    again = {file: DetectorSpec.parse(text) for file, text in files.items()}
    assert before == again
    for file, text in files.items():
        (folder / file).write_text("other")
        after = DetectorSpec.parse(text)
        assert after.identity != before[file].identity
        assert after.name == before[file].name
    assert [spec.name for spec in before.values()] == ["rooms.own:detect", "net.onnx", "detect.py"]


def test_the_identity_of_a_command_holds_the_files_of_its_options(folder: Path) -> None:
    (folder / "weights.pt").write_text("one")
    text = "detect --weights=weights.pt {reference} {followup} --out={out}"
    before = DetectorSpec.parse(text)
    (folder / "weights.pt").write_text("other")
    assert DetectorSpec.parse(text).identity != before.identity
    assert before.name == "detect"


def test_finding_the_file_of_a_module_runs_nothing(folder: Path) -> None:
    (folder / "loud.py").write_text("raise SystemExit('imported')")
    (folder / "room").mkdir()
    (folder / "room" / "__init__.py").write_text("raise SystemExit('imported')")
    (folder / "room" / "inner.py").write_text("raise SystemExit('imported')")
    assert str(folder / "loud.py") in DetectorSpec.parse("loud:f").identity
    assert str(folder / "room" / "inner.py") in DetectorSpec.parse("room.inner:f").identity
    assert "loud" not in sys.modules


def test_a_spec_is_pickled_and_a_callable_with_it() -> None:
    for spec in (DetectorSpec.parse("ncc"), DetectorSpec.of_callable(mean_level)):
        assert pickle.loads(pickle.dumps(spec)) == spec
    assert DetectorSpec.of_callable(mean_level).name == "mean_level"


def test_the_identity_of_a_callable_is_that_of_its_code_and_state() -> None:
    def times(gain: float) -> DetectorSpec:
        return DetectorSpec.of_callable(lambda _, followup, __: gain * float(followup.mean()))

    assert times(1.0).identity == times(1.0).identity
    assert times(1.0).identity != times(2.0).identity
    locked = partial(mean_level, homography=Lock())  # type: ignore[arg-type] # not to be pickled
    one, other = (DetectorSpec.of_callable(locked) for _ in range(2))
    assert one.identity != other.identity


def test_one_that_takes_colours_is_another_detector(monkeypatch: pytest.MonkeyPatch) -> None:
    before = DetectorSpec.of_callable(mean_level).identity
    monkeypatch.setattr(mean_level, "colour", True, raising=False)
    assert DetectorSpec.of_callable(mean_level).identity != before


def test_what_is_no_callable_is_refused() -> None:
    with pytest.raises(TypeError, match="expected a callable, got str"):
        DetectorSpec.of_callable("ssim")  # type: ignore[arg-type]


def test_an_error_comes_back_from_a_worker_with_its_reason() -> None:
    error = pickle.loads(pickle.dumps(DetectorError("no answer", reason="hung")))
    assert (str(error), error.reason) == ("no answer", "hung")


@given(st.text())
@settings(max_examples=50)
def test_any_text_is_a_detector_or_missing(text: str) -> None:
    try:
        spec = DetectorSpec.parse(text)
    except DetectorError:
        with pytest.raises(DetectorError) as raised:
            DetectorSpec.parse(text)
        assert raised.value.reason == "missing"
    else:
        assert spec.name.isprintable()
        assert spec.identity
