"""The PSF of a phone's own frames: of known lenses it is right, and nothing of it is kept too long.

The frames are rendered by code that shares nothing with the calibration (`Wall.through`).
"""

from pathlib import Path

import cv2
import numpy as np
import pytest

from acquisition.session import Session
from benchmarks.studies.guided_psf import Shown, away, fine_frame
from benchmarks.truth.hand_held import HeldPose
from standoff import import_photographs
from standoff.console.guide import (
    GuidedReference,
    GuideReference,
    Judge,
    LiveGuidance,
    ReferenceShelf,
)
from standoff.console.guide._assessment import dprime_lost
from standoff.console.guide._own_psf import OwnPsf
from tests.standoff.console.guide.scenes import Stills, wall
from tests.standoff.console.guide.test_assessment import curve

pytestmark = pytest.mark.slow(minutes=0.5)

SCENE = wall().resized((640, 480))


def rng() -> np.random.Generator:
    return np.random.default_rng(8)


@pytest.fixture
def phone(stills: Stills) -> Shown:
    return Shown(GuideReference.read(stills.reference))


def frame(sigma_px: float, distance: float = 1.0) -> bytes:
    pose = HeldPose() if distance == 1 else away(distance, rng())
    return fine_frame(SCENE.through(pose, sigma_px, rng()))


@pytest.mark.parametrize("sigma_px", [0.7, 1.5])
def test_two_distances_of_an_approach_tell_the_width_of_a_known_lens(
    phone: Shown, sigma_px: float
) -> None:
    phone.hold(frame(sigma_px, 1.45))
    phone.hold(frame(sigma_px))
    found = phone.live.frame_curve_of("")
    assert found is not None
    assert found.ratio == pytest.approx(1.45, abs=0.03)
    assert abs(found.sigma_px - sigma_px) < 2 * found.sigma_err_px
    assert found.sigma_err_px < 0.2 * sigma_px
    assert "at two distances (1 : 1.4" in found.words


def test_what_is_lost_further_away_follows_and_is_said(phone: Shown) -> None:
    phone.hold(frame(0.7, 1.45))
    before = phone.look(frame(0.7, 1.45))
    phone.hold(frame(0.7))
    back = phone.look(frame(0.7))
    away_ = phone.look(frame(0.7, 1.45))
    assert back.verdict == "go"
    assert back.quality is not None
    assert away_.quality is not None
    lost, lost_away = dprime_lost(back.quality), dprime_lost(away_.quality)
    assert lost is not None
    assert lost_away is not None
    assert lost < 0.05 < 0.2 < lost_away
    assert f"{100 * lost_away:.0f} % is lost" in away_.words
    assert "this phone's own pictures at two distances" in back.judged_by
    assert "two distances" not in before.judged_by


def test_a_camera_that_is_blurred_all_the_way_is_good_nowhere(phone: Shown) -> None:
    for distance in (1.45, 1.2, 1.0, 1.0):
        phone.hold(frame(3.0, distance))
    assert phone.greens == 0
    found = phone.live.frame_curve_of("")
    assert found is None or found.sigma_px > 1.5
    # The null: the same approach of a sharp camera ends good.
    phone.hold(frame(0.7))
    assert phone.greens > 0


def test_what_an_earlier_approach_told_is_not_kept(phone: Shown) -> None:
    phone.hold(frame(0.7, 1.45))
    phone.hold(frame(0.7))
    assert phone.live.frame_curve_of("") is not None
    assert phone.live.frame_curve_of("another phone") is None
    phone.live.look(frame(0.7), taken_s=60.0)
    assert phone.live.frame_curve_of("") is None


def test_nothing_is_measured_on_frames_that_move_or_are_compressed(phone: Shown) -> None:
    for distance in (1.6, 1.3, 1.6, 1.3):  # 3 frames of movement between two that are still
        phone.look(frame(0.7, distance), is_fine=True)
    phone.look(frame(0.7))
    phone.look(frame(0.7))
    small = cv2.imdecode(np.frombuffer(frame(0.7), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert small is not None
    half = fine_frame(np.asarray(cv2.resize(small, (480, 360)), np.uint8))
    for _ in range(3):
        phone.look(half, is_fine=True)
    phone.live.wait(60)
    assert phone.live.frame_curve_of("") is None


def test_a_finer_frame_is_asked_for_where_it_tells_more_and_where_the_hand_is_still(
    phone: Shown,
) -> None:
    assert not phone.look(frame(0.7)).wants_fine  # nobody knows whether it moves
    assert phone.look(frame(0.7)).wants_fine
    phone.hold(frame(0.7))
    assert not phone.look(frame(0.7)).wants_fine  # there is one from here
    assert phone.look(frame(0.7, 1.45)).wants_fine is False  # it moved
    assert phone.look(frame(0.7, 1.45)).wants_fine


def test_with_curves_given_nothing_is_measured(stills: Stills) -> None:
    judge = Judge(GuideReference.read(stills.reference), curve([4.0, 3.0, 2.0]), 1.0)
    live = LiveGuidance(judge)
    for number in range(4):
        found = live.look(frame(0.7), taken_s=0.2 * number, is_fine=True)
    live.wait(60)
    assert not found.wants_fine
    assert found.judged_by == ""
    assert live.frame_curve_of("") is None


def test_one_measurement_runs_at_a_time(phone: Shown, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[OwnPsf] = []
    monkeypatch.setattr("standoff.console.guide._own_psf._measured", lambda *_: nested())
    own = OwnPsf(phone.live.judge_of("").reference)

    def nested() -> None:
        asked.append(own)
        own.measure()  # returns at once, as one is at work

    phone.look(frame(0.7))
    phone.look(frame(0.7), is_fine=True)
    phone.live.wait(60)
    assert len(asked) == 1


def test_a_reference_that_is_chosen_again_is_judged_by_what_is_known_then(
    stills: Stills, tmp_path: Path
) -> None:
    session = tmp_path / "earlier"
    import_photographs([stills.reference], session, kind="texture", height_mm=0)
    (record,) = Session(session).records
    shelf = ReferenceShelf(tmp_path, tmp_path / "incoming")
    try:
        first: GuidedReference = shelf[shelf.choose(session, record, curve([4.0, 3.0, 2.0]), 1.0)]
        assert first.store._inputs().psf is None
        (session / "results").mkdir(exist_ok=True)
        (session / "results" / "psf.json").touch()
        assert first.store._inputs().psf == session / "results" / "psf.json"
        assert first.judge.has_curve
        again = shelf[shelf.choose(session, record)]
        assert again is first
        assert not again.judge.has_curve
    finally:
        shelf.close()
