"""Choosing a curve, a threshold and a reference: what counts from then on, and what is said."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")

from acquisition.devices import Frame
from analysis.detectability import DetectabilityCurves
from analysis.results_file import write_results
from standoff.console.bench_hub import BenchHub
from standoff.console.web.command_handler import CommandHandler, NotInControlError
from standoff.console.web.messages import MessageError, parse_message
from standoff.console.web.view_model import state_document
from standoff.errors import ApplicationError
from tests.acquisition.fakes import SETTINGS
from tests.analysis.detectability.test_curves import curve
from tests.standoff.console.hub_fixtures import idle_hub
from tests.standoff.console.test_bench_hub import Operator
from tests.standoff.console.web.test_pages import texture

SEVERAL = DetectabilityCurves(curves=[curve(), curve(noise_dn=4.0)])


@pytest.fixture
def hub(tmp_path: Path) -> BenchHub:
    made = idle_hub(tmp_path)
    made.sessions.folder.mkdir()
    write_results(made.sessions.folder / "curves.json", SEVERAL)
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
        "The reference has 320 × 240 pixels, the live picture 64 × 48: it cannot lie over it."
    )
