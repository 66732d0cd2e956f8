"""By what poses are judged: files that the console knows, their curves, and files that are sent."""

import json
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from analysis.detectability import CurveChoice, DetectabilityCurves
from analysis.errors import ResultsFileError
from analysis.results_file import write_results
from standoff.console.devices import TrackerMaker
from standoff.console.pose_curves import MOST_BYTES, GivenCurves, PoseCurves
from standoff.errors import ApplicationError, ArgumentError
from tests.analysis.detectability.test_curves import curve

SEVERAL = DetectabilityCurves(curves=[curve(), curve(noise_dn=4.0), curve(contrast_dn=6.0)])


def written(path: Path, document: DetectabilityCurves) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_results(path, document)
    return path


def bytes_of(folder: Path, document: DetectabilityCurves) -> bytes:
    return written(folder / "made.json", document).read_bytes()


class Judge:
    """Keeps what it was last told to judge by."""

    def __init__(self) -> None:
        self.maker: TrackerMaker | None = None
        self.words: tuple[str, ...] = ()

    def __call__(self, maker: TrackerMaker | None, words: tuple[str, ...]) -> None:
        self.maker, self.words = maker, words


@pytest.fixture
def judge() -> Judge:
    return Judge()


@pytest.fixture
def curves(tmp_path: Path, judge: Judge) -> PoseCurves:
    return PoseCurves(tmp_path / "sessions", GivenCurves(), judge)


def test_what_was_given_at_the_start_counts_at_once(tmp_path: Path, judge: Judge) -> None:
    path = written(tmp_path / "spring.json", SEVERAL)
    given = GivenCurves(path=path, min_dprime=1.5, choice=CurveChoice(noise_dn=4.0))
    view = PoseCurves(tmp_path / "sessions", given, judge).view
    assert (view.file, view.chosen, view.min_dprime) == (str(path), 1, 1.5)
    assert judge.maker is not None
    assert judge.words == (
        f"--curves={path}", "--min-dprime=1.5", "--noise=4.0", "--contrast=12.0",
    )  # fmt: skip


def test_what_was_given_must_tell_which_curve_is_meant(tmp_path: Path, judge: Judge) -> None:
    path = written(tmp_path / "spring.json", SEVERAL)
    with pytest.raises(ArgumentError, match="choose by --noise"):
        PoseCurves(tmp_path, GivenCurves(path=path), judge)
    with pytest.raises(ArgumentError, match="above 0"):
        PoseCurves(tmp_path, GivenCurves(min_dprime=-1.0), judge)


def test_files_of_the_sessions_and_the_one_given_can_be_chosen_and_no_others(
    tmp_path: Path, judge: Judge
) -> None:
    sessions = tmp_path / "sessions"
    given = written(tmp_path / "elsewhere.json", SEVERAL)
    for name in ("curves.json", "b.curves.json", "plain.json", "curves/sent.json"):
        written(sessions / name, SEVERAL)
    (sessions / "curves" / "link.json").symlink_to(given)
    choice = CurveChoice(noise_dn=4.0)
    curves = PoseCurves(sessions, GivenCurves(path=given, choice=choice), judge)
    assert curves.files() == (str(given), "curves.json", "b.curves.json", "curves/sent.json")
    for name in ("plain.json", "../elsewhere.json", "curves/link.json", "/etc/passwd"):
        with pytest.raises(ApplicationError, match="no file"):
            curves.choose(name)
    assert curves.view.file == str(given)


def test_one_of_several_curves_is_chosen_by_its_number_and_names_the_result_s_options(
    tmp_path: Path, curves: PoseCurves, judge: Judge
) -> None:
    written(tmp_path / "sessions" / "curves.json", SEVERAL)
    curves.choose("curves.json")
    assert curves.view.chosen is None
    assert curves.view.curves[1] == "matched, npw, noise 4 DN, contrast 12 DN"
    assert (judge.maker, judge.words) == (None, ())
    curves.choose("curves.json", 2)
    assert curves.view.name == "matched, npw, noise 2 DN, contrast 6 DN"
    assert judge.maker is not None
    assert shlex.join(judge.words).endswith("--min-dprime=2.0 --noise=2.0 --contrast=6.0")
    with pytest.raises(ApplicationError, match="only 3 curves"):
        curves.choose("curves.json", 3)
    curves.choose("")
    assert curves.view.file == ""
    assert judge.words == ()
    assert not callable(judge.maker)


def test_the_only_curve_of_a_file_is_chosen_with_it_and_the_threshold_changes_its_words(
    tmp_path: Path, curves: PoseCurves, judge: Judge
) -> None:
    path = written(tmp_path / "sessions" / "curves.json", DetectabilityCurves(curves=[curve()]))
    curves.set_threshold(3.5)  # before there is a curve
    assert judge.maker is None
    curves.choose("curves.json")
    assert judge.words == (f"--curves={path}", "--min-dprime=3.5")
    curves.set_threshold(0.25)
    assert judge.words == (f"--curves={path}", "--min-dprime=0.25")


def test_a_curve_of_a_file_that_was_written_anew_is_not_another_one(
    tmp_path: Path, curves: PoseCurves, judge: Judge
) -> None:
    path = written(tmp_path / "sessions" / "curves.json", SEVERAL)
    curves.choose("curves.json")
    path.unlink()
    written(path, DetectabilityCurves(curves=SEVERAL.curves[::-1]))
    with pytest.raises(ApplicationError, match="written anew"):
        curves.choose("curves.json", 0)
    assert judge.maker is None
    curves.choose("curves.json", 0)
    assert curves.view.name == "matched, npw, noise 2 DN, contrast 6 DN"


def test_curves_that_differ_in_nothing_cannot_be_chosen(tmp_path: Path, curves: PoseCurves) -> None:
    twice = DetectabilityCurves(curves=[curve(), curve()])
    written(tmp_path / "sessions" / "curves.json", twice)
    with pytest.raises(ApplicationError, match="two curves called"):
        curves.choose("curves.json", 0)


def test_what_cannot_be_read_leaves_what_was_chosen(
    tmp_path: Path, curves: PoseCurves, judge: Judge
) -> None:
    sessions = tmp_path / "sessions"
    written(sessions / "curves.json", DetectabilityCurves(curves=[curve()]))
    curves.choose("curves.json")
    (sessions / "bad.curves.json").write_text("{}")
    with pytest.raises(ResultsFileError):
        curves.choose("bad.curves.json")
    assert curves.view.file == "curves.json"
    assert judge.maker is not None


def test_a_file_that_is_sent_is_kept_as_it_is_and_can_be_chosen(
    tmp_path: Path, curves: PoseCurves
) -> None:
    data, before = bytes_of(tmp_path, SEVERAL), curves.view.revision
    file = curves.store("Frühling 2.json", data)
    assert file == "curves/Frühling 2.json"
    assert (tmp_path / "sessions" / file).read_bytes() == data
    assert curves.view.revision > before
    assert curves.files() == (file,)
    assert curves.store("Frühling 2.json", data) == file  # once more
    curves.choose(file, 1)
    assert curves.view.chosen == 1


def test_another_file_of_the_name_is_not_overwritten(tmp_path: Path, curves: PoseCurves) -> None:
    data = bytes_of(tmp_path, SEVERAL)
    curves.store("a.json", data)
    with pytest.raises(ApplicationError, match="already another file"):
        curves.store("a.json", bytes_of(tmp_path, DetectabilityCurves(curves=[curve()])))
    folder = tmp_path / "sessions" / "curves"
    assert (folder / "a.json").read_bytes() == data
    outside = tmp_path / "outside.json"
    (folder / "b.json").symlink_to(outside)
    with pytest.raises(ApplicationError, match="already another file"):
        curves.store("b.json", data)
    assert not outside.exists()


def test_nothing_is_written_through_a_link_or_into_a_session(
    tmp_path: Path, curves: PoseCurves
) -> None:
    data = bytes_of(tmp_path, SEVERAL)
    sessions, outside = tmp_path / "sessions", tmp_path / "outside"
    outside.mkdir()
    sessions.mkdir()
    (sessions / "curves").symlink_to(outside)
    with pytest.raises(ApplicationError, match="a link"):
        curves.store("a.json", data)
    assert list(outside.iterdir()) == []


@pytest.mark.parametrize(
    "name",
    [
        "", ".json", ".a.json", "a.toml", "../a.json", "/a.json", "b/a.json", "b\\a.json",
        "a\n.json", "a\u202e.json", "a\0.json", "x" * 300 + ".json", "C:a.json",
    ],
)  # fmt: skip
def test_a_name_that_leads_elsewhere_is_refused(
    tmp_path: Path, curves: PoseCurves, name: str
) -> None:
    with pytest.raises(ApplicationError, match="must be called"):
        curves.store(name, bytes_of(tmp_path, SEVERAL))
    assert not (tmp_path / "sessions").exists()


def of_curve(**values: object) -> bytes:
    document = json.loads(SEVERAL.model_dump_json(by_alias=True))
    document["curves"][0] |= values
    return json.dumps(document).encode()


HOSTILE: dict[str, Callable[[], bytes]] = {
    "nothing": lambda: b"",
    "binary": lambda: bytes(range(256)) * 100,
    "a list": lambda: b"[]",
    "another document": lambda: b'{"schema": "standoff.psf/1"}',
    "a schema of a megabyte": lambda: json.dumps({"schema": "x" * 10**6}).encode(),
    "no curves": lambda: b'{"schema": "standoff.detectability/1", "curves": []}',
    "brackets": lambda: b"[" * 2_000_000,
    "objects": lambda: b'{"a":' * 500_000,
    "a number of a million digits": lambda: b'{"schema": ' + b"9" * 1_000_000 + b"}",
    "not a number": lambda: of_curve(dprime=[float("nan"), 1.0, 1.0]),
    "zooms that decrease": lambda: of_curve(zoom=[2.0, 1.5, 1.0]),
    "lines in a model": lambda: of_curve(model="a\nb\x1b[2J"),
    "too large": lambda: b" " * (MOST_BYTES + 1),
    "too many": lambda: (
        DetectabilityCurves(curves=[curve()] * 501).model_dump_json(by_alias=True).encode()
    ),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_file_that_holds_no_curves_gets_one_short_line_and_is_not_stored(
    tmp_path: Path, curves: PoseCurves, kind: str
) -> None:
    with pytest.raises(ApplicationError) as error:
        curves.store("sent.json", HOSTILE[kind]())
    text = str(error.value)
    assert text.isprintable()
    assert len(text) <= 300
    assert "sent.json" in text
    assert "/tmp" not in text
    assert not (tmp_path / "sessions").exists()


def test_a_threshold_of_the_judge_is_that_of_the_view(
    tmp_path: Path, curves: PoseCurves, judge: Judge
) -> None:
    written(tmp_path / "sessions" / "curves.json", DetectabilityCurves(curves=[curve()]))
    curves.choose("curves.json")
    curves.set_threshold(7.0)
    assert judge.maker is not None
    texture = np.random.default_rng(1).integers(0, 4096, (120, 160)).astype(np.uint16)
    assert judge.maker(texture)._min_d_prime == 7.0
