import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import tifffile

from analysis.detectors import CheckedDetector, DetectorSpec, open_detector
from analysis.errors import DetectorError, DetectorFault, OverlapError
from simulation.arrays import Float32Array
from tests.analysis.detectors.failing_detectors import (
    CALLS,
    EXITS,
    HANGS,
    INFINITE,
    NAN,
    RAISES,
    SEGFAULTS,
    SHAPE,
    TEXT,
    put_module,
)

SAME = np.eye(3)
FOLLOWUP = np.arange(35, dtype=np.float32).reshape(5, 7)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    put_module(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def asked() -> Iterator[CheckedDetector]:
    with open_detector(DetectorSpec.parse("failing:answer"), timeout_s=10.0) as detector:
        yield detector


def wanting(kind: int) -> Float32Array:
    reference = np.ones((5, 7), dtype=np.float32)
    reference[0, 0] = kind
    return reference


def command(kind: str) -> DetectorSpec:
    words = (sys.executable, "-S", "failing_command.py", kind)
    return DetectorSpec.parse(shlex.join(words) + " {reference} {out} {followup} {homography}")


def failure(spec: DetectorSpec, reference: Float32Array, timeout_s: float = 30.0) -> DetectorError:
    with open_detector(spec, timeout_s) as detector, pytest.raises(DetectorError) as raised:
        detector(reference, FOLLOWUP, SAME)
    assert "\n" not in str(raised.value)
    return raised.value


def is_running(pid: int) -> bool:
    """Whether a process runs; one that nobody waited for has ended."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def ends_soon(pid: int, within_s: float = 30.0) -> bool:
    until_s = time.monotonic() + within_s
    while is_running(pid) and time.monotonic() < until_s:
        time.sleep(0.02)
    return not is_running(pid)


@pytest.mark.parametrize(
    ("kind", "reason", "words"),
    [
        (EXITS, "crashed", ("ended with status 3", "it last said: no licence")),
        (SEGFAULTS, "crashed", ("killed by SIGSEGV", "it last said: about to read 0")),
        (RAISES, "crashed", ("it raised",)),
        (NAN, "not_finite", ("it returned nan",)),
        (INFINITE, "not_finite", ("not finite at 35 of the 35 px",)),
        (SHAPE, "shape", ("2 x 3", "5 x 7 px")),
        (TEXT, "output", ("it returned a str",)),
    ],
)
def test_a_failed_pair_is_named_and_the_next_one_finds_a_fresh_process(
    asked: CheckedDetector, kind: int, reason: DetectorFault, words: tuple[str, ...]
) -> None:
    assert [asked(wanting(CALLS), FOLLOWUP, SAME).score for _ in range(2)] == [1, 2]
    with pytest.raises(DetectorError, match=r"^detector failing:answer: it") as raised:
        asked(wanting(kind), FOLLOWUP, SAME)
    assert raised.value.reason == reason
    assert "\n" not in str(raised.value)
    for word in words:
        assert word in str(raised.value)
    assert asked(wanting(CALLS), FOLLOWUP, SAME).score == 1


@pytest.mark.slow
def test_a_hanging_pair_ends_in_time_and_the_next_one_finds_a_fresh_process(folder: Path) -> None:
    with open_detector(DetectorSpec.parse("failing:answer"), timeout_s=2.0) as detector:
        assert [detector(wanting(CALLS), FOLLOWUP, SAME).score for _ in range(2)] == [1, 2]
        with pytest.raises(DetectorError, match="no answer within 2 s; it last said: ") as raised:
            detector(wanting(HANGS), FOLLOWUP, SAME)
        assert raised.value.reason == "hung"
        assert ends_soon(int((folder / "hung.pid").read_text()))
        assert detector(wanting(CALLS), FOLLOWUP, SAME).score == 1


def test_a_child_gets_the_photographs_as_they_are_and_ours_stay_as_they_were() -> None:
    reference = np.linspace(0, 1, 35, dtype=np.float32).reshape(5, 7)
    kept = reference.copy()
    with open_detector(DetectorSpec.parse("failing:difference")) as detector:
        answer = detector(reference, FOLLOWUP, SAME)
    assert answer.map is not None
    np.testing.assert_array_equal(answer.map, np.abs(kept - FOLLOWUP))
    assert answer.score == np.abs(kept - FOLLOWUP).max()
    np.testing.assert_array_equal(reference, kept)


def test_a_homography_reaches_the_child_to_the_last_digit() -> None:
    moved = np.array([[1, 0, 1 / 3], [0, 1, 0], [0, 0, 1]])
    with open_detector(DetectorSpec.parse("failing:Nested.moment")) as detector:
        assert detector(wanting(CALLS), FOLLOWUP, moved).score == 1 / 3


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("nowhere:answer", "No module named 'nowhere'; run in the folder of nowhere"),
        ("failing:nothing", "module failing has no function nothing"),
        ("failing:not_a_function", "has no function"),
    ],
)
def test_a_function_that_is_not_there_is_said_before_the_first_pair(text: str, word: str) -> None:
    with (
        pytest.raises(DetectorError, match=word) as raised,
        open_detector(DetectorSpec.parse(text)),
    ):
        pass
    assert raised.value.reason == "missing"


@pytest.mark.parametrize(
    ("code", "reason"),
    [("import os; os._exit(7)", "crashed"), ("raise KeyError('x')", "missing"), ("(", "missing")],
)
def test_a_module_that_fails_while_it_is_imported_is_named(
    folder: Path, code: str, reason: DetectorFault
) -> None:
    (folder / "unsound.py").write_text(code)
    with (
        pytest.raises(DetectorError, match="detector unsound:f") as raised,
        open_detector(DetectorSpec.parse("unsound:f")),
    ):
        pass
    assert raised.value.reason == reason


def test_a_module_called_like_one_of_ours_hides_nothing_from_us(folder: Path) -> None:
    (folder / "analysis.py").write_text("raise SystemExit('hidden')")
    with open_detector(DetectorSpec.parse("failing:answer")) as detector:
        assert detector(wanting(CALLS), FOLLOWUP, SAME).score == 1


def test_a_callable_runs_here_and_its_faults_are_caught() -> None:
    def of(answer: object) -> DetectorSpec:
        def detector(*_: object) -> object:
            if isinstance(answer, BaseException):
                raise answer
            return answer

        return DetectorSpec.of_callable(detector)  # type: ignore[arg-type] # that is the point

    class OnAnotherDevice:
        def __array__(self, *_: object, **__: object) -> None:
            raise TypeError("copy the tensor to host memory first")

    faults: tuple[tuple[object, DetectorFault, str], ...] = (
        (ZeroDivisionError("no light"), "crashed", "it raised ZeroDivisionError: no light"),
        (SystemExit(2), "crashed", "it raised SystemExit: 2"),
        (OnAnotherDevice(), "crashed", "copy the tensor to host memory first"),
        (float("inf"), "not_finite", "it returned inf"),
        (np.full((5, 7), np.nan), "not_finite", "35 of the 35 px"),
        (np.zeros((7, 5)), "shape", "7 x 5"),
        (np.zeros(35), "shape", "35 values"),
        (None, "output", "None"),
        ([1.0], "output", "a list"),
        (np.zeros((5, 7), dtype=complex), "output", "complex128"),
    )
    for answer, reason, word in faults:
        error = failure(of(answer), wanting(CALLS))
        assert error.reason == reason
        assert word in str(error)
    with open_detector(of(np.float32(2))) as detector:
        assert detector(wanting(CALLS), FOLLOWUP, SAME).score == 2


@pytest.mark.slow
def test_a_module_says_by_its_attribute_that_its_detector_takes_colours() -> None:
    colours = np.stack([FOLLOWUP, FOLLOWUP + 7, FOLLOWUP], axis=2)
    with open_detector(DetectorSpec.parse("failing:channels")) as detector:
        assert detector.takes_colour
        assert detector(colours, colours, SAME).score == 3 + 7
        assert detector(FOLLOWUP, FOLLOWUP, SAME).score == 3  # one plane three times
    with open_detector(DetectorSpec.parse("failing:difference")) as detector:
        assert not detector.takes_colour
        answer = detector(colours, FOLLOWUP, SAME)
        assert answer.map is not None
        assert answer.map.shape == FOLLOWUP.shape
        # The second plane is the green of the luma.
        np.testing.assert_allclose(answer.map, 0.587 * 7, rtol=1e-5)


def test_pixels_outside_of_the_reference_do_not_count() -> None:
    def detector(_: Float32Array, followup: Float32Array, __: object) -> Float32Array:
        found = followup.copy()
        found[:, 5:] = np.nan
        return found

    # The last two columns look past the reference.
    moved = np.array([[1.0, 0, 2], [0, 1, 0], [0, 0, 1]])
    with open_detector(DetectorSpec.of_callable(detector)) as asked:
        answer = asked(wanting(CALLS), FOLLOWUP, moved)
        assert answer.score == 32  # row 4, column 4
        assert answer.map is not None
        assert answer.map[:, 5:].tolist() == [[0, 0]] * 5
        far = np.array([[1.0, 0, 9], [0, 1, 0], [0, 0, 1]])
        with pytest.raises(OverlapError, match="no pixel"):
            asked(wanting(CALLS), FOLLOWUP, far)


@pytest.mark.parametrize(
    ("kind", "reason", "words"),
    [
        ("exits", "crashed", ("ended with status 3", "it last said: no licence")),
        ("aborts", "crashed", ("killed by SIGABRT", "it last said: working on aborts")),
        ("nothing", "output", ("it wrote nothing to {out}", "working on nothing")),
        ("folder", "output", ("{out} cannot be read",)),
        ("prose", "output", ("neither a TIFF nor a JSON number",)),
        ("list", "output", ("is a list",)),
        ("true", "output", ("is a bool",)),
        ("cut", "output", ("the TIFF in {out} is damaged",)),
        ("nan", "not_finite", ("it returned nan",)),
        ("huge", "not_finite", ("it returned inf",)),
    ],
)
def test_what_a_command_does_wrong_is_named(
    kind: str, reason: DetectorFault, words: tuple[str, ...]
) -> None:
    error = failure(command(kind), wanting(CALLS))
    assert error.reason == reason
    assert str(error).startswith("detector failing_command.py: ")
    for word in words:
        assert word in str(error)


def test_a_command_answers_with_a_number_or_a_map_of_the_followups_shape() -> None:
    with open_detector(command("number")) as detector:
        assert detector(wanting(CALLS), FOLLOWUP, SAME).score == 2.5
    with open_detector(command("whole")) as detector:  # it copies the reference
        answer = detector(FOLLOWUP + 0.25, FOLLOWUP, SAME)
        assert answer.map is not None
        np.testing.assert_array_equal(answer.map, FOLLOWUP + 0.25)
    error = failure(command("whole"), np.zeros((6, 7), dtype=np.float32))
    assert (error.reason, "6 x 7" in str(error)) == ("shape", True)


@pytest.mark.slow
def test_a_command_that_hangs_is_killed_with_what_it_started(folder: Path) -> None:
    bystander = subprocess.Popen([sys.executable, "-S", "-c", "input()"], stdin=subprocess.PIPE)
    try:
        error = failure(command("hangs"), wanting(CALLS), timeout_s=2.0)
        assert error.reason == "hung"
        assert "not done within 2 s" in str(error)
        for pid in (folder / "hung.pid").read_text().split():
            assert ends_soon(int(pid))
        assert bystander.poll() is None
    finally:
        bystander.communicate(b"\n")


def test_a_program_that_is_not_there_is_missing(folder: Path) -> None:
    spec = DetectorSpec.parse("./no-such-program {reference} {followup} {out}")
    error = failure(spec, wanting(CALLS))
    assert error.reason == "missing"
    assert "./no-such-program cannot be run: No such file or directory" in str(error)
    (folder / "plain").write_text("data")
    spec = DetectorSpec.parse("./plain {reference} {followup} {out}")
    assert failure(spec, wanting(CALLS)).reason == "missing"


def test_a_command_finds_its_files_and_no_shell_sees_its_words(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = folder / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    copies = "[shutil.copy(path, '.') for path in sys.argv[1:4]]"
    script = f"import sys, shutil; {copies}; print(1, file=open(sys.argv[4], 'w'))"
    words = shlex.join([sys.executable, "-S", "-c", script])
    spec = DetectorSpec.parse(f"{words} {{reference}} {{followup}} {{homography}} {{out}} '$HOME;'")
    with open_detector(spec) as detector:
        assert detector(FOLLOWUP + 0.1, FOLLOWUP[:4], SAME).score == 1
    np.testing.assert_array_equal(tifffile.imread("reference.tif"), FOLLOWUP + np.float32(0.1))
    np.testing.assert_array_equal(tifffile.imread("followup.tif"), FOLLOWUP[:4])
    from calibration.files import read_homography

    read = read_homography(Path("homography.json"))
    assert read.size == (7, 4)
    np.testing.assert_array_equal(read.matrix, SAME)
    assert list(temporary.iterdir()) == []


HANGING = """
import numpy as np
from analysis.detectors import DetectorSpec, open_detector

reference = np.full((5, 7), 4.0)
with open_detector(DetectorSpec.parse({text!r}), 500) as detector:
    detector(reference, np.ones((5, 7)), np.eye(3))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("host", "number"),
    # A command does not know who started it: SIGKILL leaves it to end by itself.
    [("function", signal.SIGINT), ("function", signal.SIGKILL), ("command", signal.SIGINT)],
)
def test_a_hanging_detector_does_not_outlive_who_asked_it(
    folder: Path, host: str, number: signal.Signals
) -> None:
    text = "failing:answer" if host == "function" else command("hangs").text
    temporary = folder / "temporary"
    temporary.mkdir()
    asking = subprocess.Popen(
        [sys.executable, "-c", HANGING.format(text=text)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "TMPDIR": str(temporary)},
        stderr=subprocess.PIPE,
    )
    try:
        pids = folder / "hung.pid"
        until_s = time.monotonic() + 60
        while not (pids.exists() and pids.read_text()) and time.monotonic() < until_s:
            time.sleep(0.02)
        hung = [int(pid) for pid in pids.read_text().split()]
        assert all(is_running(pid) for pid in hung)
        asking.send_signal(number)
        asking.communicate(timeout=20)
        for pid in hung:
            assert ends_soon(pid)
        assert number == signal.SIGKILL or list(temporary.iterdir()) == []
    finally:
        with suppress(ProcessLookupError):
            asking.kill()
        asking.communicate()


@pytest.mark.slow
def test_an_interrupt_while_a_command_is_started_ends_it_as_well(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pids = folder / "hung.pid"

    def interrupted(_: threading.Thread) -> None:
        until_s = time.monotonic() + 60
        while not (pids.exists() and pids.read_text()) and time.monotonic() < until_s:
            time.sleep(0.02)
        raise KeyboardInterrupt

    monkeypatch.setattr(threading.Thread, "start", interrupted)
    with open_detector(command("hangs")) as detector, pytest.raises(KeyboardInterrupt):
        detector(wanting(CALLS), FOLLOWUP, SAME)
    for pid in pids.read_text().split():
        assert ends_soon(int(pid), within_s=5.0)


def test_a_time_that_is_none_and_photographs_that_are_none_are_refused() -> None:
    spec = DetectorSpec.of_callable(lambda *_: 1.0)
    for timeout_s in (0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="timeout_s"), open_detector(spec, timeout_s):
            pass
    with open_detector(spec) as detector:
        for reference in (np.zeros((3, 3, 4)), np.zeros((0, 3)), np.full((3, 3), np.nan)):
            with pytest.raises(ValueError, match="reference"):
                detector(reference, FOLLOWUP, SAME)
        with pytest.raises(ValueError, match="homography"):
            detector(FOLLOWUP, FOLLOWUP, np.zeros((3, 3)))
