"""By what poses are judged: curves, threshold and reference, as chosen, sent and fetched."""

import json
import shlex
from collections.abc import Callable, Iterator
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.errors import ResultsFileError
from standoff.console.monitors import TrackerMaker

pytest.importorskip("starlette", reason="the console's extra is not installed")


from acquisition.devices import Frame
from analysis.detectability import CurveChoice, DetectabilityCurves
from analysis.results_file import write_results
from standoff.console.bench_hub import BenchHub
from standoff.console.pose_curves import MOST_BYTES, GivenCurves, PoseCurves
from standoff.console.web._command_handler import CommandHandler, parse_message
from standoff.console.web._messages import MessageError
from standoff.console.web._session_commands import NotInControlError
from standoff.console.web._view_model import state_document
from standoff.errors import ApplicationError, ArgumentError
from tests.acquisition.fakes import SETTINGS
from tests.analysis.detectability.test_curves import curve
from tests.standoff.console.hub_fixtures import DEADLINE_S, idle_hub
from tests.standoff.console.served import Address, answer_of, sent, served
from tests.standoff.console.test_application import texture
from tests.standoff.console.test_bench_hub import Operator

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
    with pytest.raises(ArgumentError, match="choose one with --noise"):
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
    with pytest.raises(ApplicationError, match="has been rewritten"):
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


TWO = DetectabilityCurves(curves=[curve(), curve(noise_dn=4.0)])


@pytest.fixture
def hub(tmp_path: Path) -> BenchHub:
    made = idle_hub(tmp_path)
    made.sessions.folder.mkdir()
    write_results(made.sessions.folder / "curves.json", TWO)
    return made


def test_what_is_chosen_counts_for_the_verdict_and_for_results_and_is_told(hub: BenchHub) -> None:
    operator = Operator(hub)
    assert not hub.results.has_curves
    operator.say(do="pose-curve", file="curves.json")
    assert not hub.pose.view.is_possible
    assert not hub.notices  # the card asks which
    operator.say(do="pose-curve", file="curves.json", curve=1)
    assert hub.pose.view.is_possible
    assert hub.results.has_curves
    operator.say(do="pose-threshold", min_dprime=0.5)
    assert hub.notices[-1].text == (
        "Poses are judged by curves.json: matched, npw, noise 4 DN, contrast 12 DN; "
        "d' at least 0.5."
    )
    assert state_document(hub)["pose"]["curve"] == {
        "revision": 2,
        "file": "curves.json",
        "name": "matched, npw, noise 4 DN, contrast 12 DN",
        "chosen": 1,
        "min_dprime": 0.5,
    }
    operator.say(do="pose-curve", file="")
    assert (hub.pose.view.is_possible, hub.results.has_curves) == (False, False)
    assert hub.notices[-1].text.startswith("No curve judges poses")


def test_who_watches_changes_nothing(hub: BenchHub) -> None:
    Operator(hub)
    handler = CommandHandler(hub)
    for text in (
        '{"do": "pose-curve", "file": "curves.json", "curve": 0}',
        '{"do": "pose-threshold", "min_dprime": 1}',
        '{"do": "pose-reference"}',
        '{"do": "pose-clear"}',
    ):
        with pytest.raises(NotInControlError):
            handler.carry_out("f" * 32, parse_message(text))
    assert state_document(hub)["pose"]["curve"]["min_dprime"] == 2.0
    assert hub.curves.view.file == ""


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("0", "The threshold of d' must be more than 0."),
        ("-2", "The threshold of d' must be more than 0."),
        ("1e9", "The threshold of d' must be at most 1000."),
    ],
)
def test_a_threshold_that_cannot_be_is_refused_in_the_operator_s_words(
    value: str, words: str
) -> None:
    with pytest.raises(MessageError) as error:
        parse_message(f'{{"do": "pose-threshold", "min_dprime": {value}}}')
    assert str(error.value) == words


def test_a_reference_needs_no_curve_and_is_judged_once_there_is_one(hub: BenchHub) -> None:
    operator = Operator(hub)
    with pytest.raises(ApplicationError, match="no picture"):
        operator.say(do="pose-reference")
    hub.frames.publish(Frame(image_dn=texture(), frame_id=1, timestamp_ns=1), SETTINGS)
    operator.say(do="pose-reference")
    pose = state_document(hub)["pose"]
    assert (pose["reference"], pose["verdict"]) == ("the picture taken just now", "")
    assert pose["reason"] == "no curve judges poses"
    assert pose["overlay"]["fault"] == ""
    number = pose["overlay"]["number"]
    operator.say(do="pose-curve", file="curves.json")
    assert state_document(hub)["pose"]["reason"] == "choose a curve"
    operator.say(do="pose-curve", file="curves.json", curve=0)
    pose = state_document(hub)["pose"]
    assert (pose["verdict"], pose["overlay"]["number"]) == ("…", number)
    operator.say(do="pose-clear")
    assert state_document(hub)["pose"]["overlay"] == {"number": None, "fault": ""}


def test_a_reference_that_cannot_be_followed_says_so_once_there_is_a_curve(hub: BenchHub) -> None:
    operator = Operator(hub)
    hub.pose.choose("grey", np.full((240, 320), 700, np.uint16))
    operator.say(do="pose-curve", file="curves.json", curve=0)
    pose = state_document(hub)["pose"]
    assert pose["reason"].startswith("this reference cannot be followed: ")
    assert (pose["verdict"], pose["reference"]) == ("", "grey")


def test_a_reference_of_another_size_cannot_lie_over_the_picture(hub: BenchHub) -> None:
    hub.pose.choose("before", texture())
    assert state_document(hub)["pose"]["overlay"]["fault"] == ""  # nothing to lie over yet
    frame = np.zeros((48, 64), np.uint16)
    hub.frames.publish(Frame(image_dn=frame, frame_id=1, timestamp_ns=1), SETTINGS)
    assert state_document(hub)["pose"]["overlay"]["fault"] == (
        "The reference has 320 × 240 pixels, the live picture 64 × 48: it cannot be overlaid."
    )


pytestmark = pytest.mark.slow

OWN = "a" * 32
CURVE_BYTES = DetectabilityCurves(curves=[curve()]).model_dump_json(by_alias=True).encode()


@pytest.fixture
def held(tmp_path: Path) -> BenchHub:
    made = idle_hub(tmp_path)
    made.control.join(OWN, "Ada")
    made.control.take(OWN)
    return made


@pytest.fixture
def address(held: BenchHub) -> Iterator[Address]:
    with served(held) as made:
        yield made


def asked(
    address: Address, method: str, path: str, data: bytes | None = None, **headers: str
) -> tuple[int, str, bytes]:
    """Status, media type and body of an answer."""
    with closing(HTTPConnection(*address, timeout=DEADLINE_S)) as connection:
        connection.request(method, path, data, headers)
        answer = connection.getresponse()
        return answer.status, answer.getheader("content-type", ""), answer.read()


def posted(
    address: Address, data: bytes, name: str = "sent.json", viewer: str = OWN, **headers: str
) -> tuple[int, Any]:
    own = {"Origin": f"http://127.0.0.1:{address[1]}", "X-Viewer": viewer}
    status, _, body = asked(address, "POST", f"/pose/curves?name={name}", data, **(own | headers))
    return status, json.loads(body)


def test_a_file_is_taken_from_the_page_in_control_and_listed(
    address: Address, held: BenchHub
) -> None:
    assert posted(address, CURVE_BYTES) == (200, {"file": "curves/sent.json"})
    status, _, body = asked(address, "GET", "/pose/curves")
    assert status == 200
    assert json.loads(body) == {
        "revision": held.curves.view.revision,
        "files": ["curves/sent.json"],
        "curves": [],
    }


@pytest.mark.parametrize(
    ("viewer", "headers"),
    [
        ("b" * 32, {}),  # a page that watches
        ("", {}),
        (OWN, {"Origin": "http://elsewhere.example"}),
        (OWN, {"Origin": "null"}),
    ],
)
def test_a_file_of_anybody_else_is_not_taken(
    address: Address, held: BenchHub, viewer: str, headers: dict[str, str]
) -> None:
    status, answer = posted(address, CURVE_BYTES, viewer=viewer, **headers)
    assert (status, answer["text"]) == (403, "You are not in control: take control first.")
    assert not held.sessions.folder.exists()


def test_while_nobody_is_in_control_nothing_is_taken(tmp_path: Path) -> None:
    held = idle_hub(tmp_path)
    with served(held) as address:
        assert posted(address, CURVE_BYTES, viewer="")[0] == 403
        assert posted(address, CURVE_BYTES, viewer="None")[0] == 403
    assert not held.sessions.folder.exists()


@pytest.mark.parametrize("name", ["..%2Fa.json", "%2Fetc%2Fa.json", "a.txt", "", "%00.json"])
def test_a_name_that_leads_elsewhere_gets_one_line(
    address: Address, held: BenchHub, name: str
) -> None:
    status, answer = posted(address, CURVE_BYTES, name)
    assert (status, list(answer)) == (422, ["text"])
    assert "must be called" in answer["text"]
    assert not held.sessions.folder.exists()


@pytest.mark.parametrize("data", [b"", b"no", b"[" * 100_000, b"{}", b'{"schema": 1}'])
def test_a_file_that_holds_no_curves_gets_one_line(
    address: Address, held: BenchHub, data: bytes
) -> None:
    status, answer = posted(address, data)
    assert (status, "sent.json" in answer["text"]) == (422, True)
    assert not held.sessions.folder.exists()


def test_a_file_that_is_too_large_is_not_read_to_its_end(address: Address, held: BenchHub) -> None:
    host = f"127.0.0.1:{address[1]}"
    head = (
        f"POST /pose/curves?name=a.json HTTP/1.1\r\nHost: {host}\r\nX-Viewer: {OWN}\r\n"
        f"Origin: http://{host}\r\nConnection: close\r\n"
    )
    stated = f"{head}Content-Length: {10**12}\r\n\r\n".encode()
    with sent(address, stated) as connection:
        assert answer_of(connection).startswith(b"HTTP/1.1 413")
    chunk = b"%x\r\n" % (MOST_BYTES + 1) + b" " * (MOST_BYTES + 1) + b"\r\n"
    unstated = f"{head}Transfer-Encoding: chunked\r\n\r\n".encode() + chunk  # and never the end
    with sent(address, unstated) as connection:
        assert answer_of(connection).startswith(b"HTTP/1.1 413")
    assert not held.sessions.folder.exists()


def test_the_reference_is_served_by_its_number_until_it_is_another(
    address: Address, held: BenchHub
) -> None:
    held.pose.choose("before", np.full((4, 6), 700, np.uint16), 4095)
    picture = held.pose.view.picture
    assert picture is not None
    for view in ("photo", "edges"):
        path = f"/pose/reference.png?view={view}&of={picture.number}"
        assert asked(address, "GET", path) == (200, "image/png", picture.png(view))
    for path in ("?of=1", "", f"?view=all&of={picture.number}", f"?of={picture.number}0"):
        assert asked(address, "GET", f"/pose/reference.png{path}")[0] == 404
    held.pose.choose("after", np.full((4, 6), 700, np.uint16), 4095)
    gone = f"/pose/reference.png?view=photo&of={picture.number}"
    assert asked(address, "GET", gone)[0] == 404
    held.pose.clear()
    assert asked(address, "GET", gone)[0] == 404


def test_without_the_token_nothing_of_the_pose_is_served_or_taken(tmp_path: Path) -> None:
    held = idle_hub(tmp_path)
    held.control.join(OWN, "Ada")
    held.control.take(OWN)
    held.pose.choose("before", np.full((4, 6), 700, np.uint16), 4095)
    picture = held.pose.view.picture
    assert picture is not None
    with served(held, token="long enough to be safe") as address:
        path = f"/pose/reference.png?view=photo&of={picture.number}"
        assert asked(address, "GET", path)[0] == 401
        assert asked(address, "GET", "/pose/curves")[0] == 401
        headers = {"Origin": f"http://127.0.0.1:{address[1]}", "X-Viewer": OWN}
        assert asked(address, "POST", "/pose/curves?name=a.json", CURVE_BYTES, **headers)[0] == 401
    assert not held.sessions.folder.exists()
