"""Frames of a phone: hostile ones are refused, the newest is judged, the scene is found again."""

import asyncio
import io
from contextlib import suppress
from itertools import count
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from benchmarks.truth.hand_held import HeldPose
from calibration.errors import CalibrationError
from calibration.registration import TrackingReference
from standoff.console.guide import GuideReference, Judge, LiveGuidance
from standoff.console.guide._assessment import Assessment
from standoff.console.guide._live import _MOST_PHONES, FrameError, decoded_frame
from tests.standoff.console.guide.scenes import Stills, again_pose, wall

pytestmark = pytest.mark.slow


def frame(pose: HeldPose, seed: int = 1, size: tuple[int, int] = (640, 480)) -> bytes:
    seen = wall(seed).resized(size).seen([pose], np.random.default_rng(5))
    return jpeg(seen)


def jpeg(levels: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".jpg", levels)[1].tobytes()


@pytest.fixture
def live(stills: Stills) -> LiveGuidance:
    """Frames come five times a second."""
    times_s = count(0.0, 0.2)
    return LiveGuidance(Judge(GuideReference.read(stills.reference)), clock=lambda: next(times_s))


def held(live: LiveGuidance, data: bytes) -> Assessment:
    """What is said of a frame when it is the second of its kind."""
    live.look(data)
    return live.look(data)


def test_from_the_references_pose_it_is_good_and_there_is_no_arrow(live: LiveGuidance) -> None:
    found = held(live, frame(HeldPose()))
    assert found.verdict == "go"
    assert found.arrows == ()
    corners = np.array(found.outline)
    np.testing.assert_allclose(corners, [[0, 0], [1, 0], [1, 1], [0, 1]], atol=0.01)


@pytest.mark.parametrize(
    ("pose", "first"),
    [
        (HeldPose(centre=np.array([0, 0, -0.3])), "nearer"),
        (HeldPose(centre=np.array([0, 0, 0.2])), "further"),
        (HeldPose(centre=np.array([0.15, 0, 0])), "left"),
        (HeldPose(centre=np.array([0, -0.12, 0])), "down"),
        (HeldPose(axes=Rotation.from_euler("z", 12, degrees=True).as_matrix()),
         "turn anticlockwise"),
    ],
)  # fmt: skip
def test_the_first_arrow_undoes_what_was_done(
    live: LiveGuidance, pose: HeldPose, first: str
) -> None:
    found = live.look(frame(pose))
    assert found.verdict == "no go"
    assert found.arrows[0].name == first
    assert found.remedy.startswith(first)


def test_blur_darkness_and_another_scene_are_never_good(live: LiveGuidance) -> None:
    sharp = cv2.imdecode(np.frombuffer(frame(HeldPose()), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert sharp is not None
    live.look(frame(HeldPose()))
    blurred = held(live, jpeg(np.asarray(cv2.GaussianBlur(sharp, (0, 0), 6), np.uint8)))
    assert blurred.verdict != "go"
    dark = held(live, jpeg((sharp // 12).astype(np.uint8)))
    assert dark.verdict != "go"
    for seed in (9, 10, 11):
        other = live.look(frame(HeldPose(), seed))
        assert other.verdict == "no go"
        assert other.outline == ()
    assert live.look(jpeg(np.full((480, 640), 7, np.uint8))).verdict == "no go"


def test_it_is_found_again_by_the_next_frame(live: LiveGuidance) -> None:
    live.look(frame(HeldPose()))
    for _ in range(3):
        assert live.look(frame(HeldPose(), 9)).outline == ()
    found = live.look(frame(again_pose()))
    assert len(found.outline) == 4
    assert live.look(frame(again_pose())).verdict == "go"


def test_nothing_is_good_as_long_as_the_hand_may_move(live: LiveGuidance) -> None:
    data = frame(HeldPose())
    first = live.look(data)
    assert first.verdict == "unsure"
    assert first.faults == ("hold still",)
    assert live.look(data).verdict == "go"
    assert live.look(data, taken_s=100.0).verdict == "unsure"  # long after
    assert live.look(data, taken_s=99.9).verdict == "unsure"  # the phone's clock began anew


def test_motion_is_told_by_the_clock_of_the_phone_and_of_each_apart(live: LiveGuidance) -> None:
    # 1 % of the picture aside: in .02 s that is fast, in .5 s slow.
    near, aside = (frame(HeldPose(centre=np.array([x, 0, 0]))) for x in (0.0, 0.0125))
    live.look(aside, phone="one", taken_s=10.0)
    live.look(near, phone="other", taken_s=10.0)
    assert live.look(near, phone="one", taken_s=10.02).verdict == "unsure"
    assert live.look(near, phone="other", taken_s=10.02).verdict == "go"
    live.look(aside, phone="one", taken_s=20.0)
    assert live.look(near, phone="one", taken_s=20.5).verdict == "go"


def test_no_more_phones_are_told_apart_than_there_may_be(live: LiveGuidance) -> None:
    for number in range(3 * _MOST_PHONES):
        live._known(str(number))
    assert len(live._phones) == _MOST_PHONES


def test_the_phone_that_was_heard_longest_ago_is_forgotten_first(live: LiveGuidance) -> None:
    for number in range(_MOST_PHONES):
        live._known(str(number))
    live._known("0")  # is heard again
    live._known("one more")
    assert "0" in live._phones
    assert "1" not in live._phones


def test_what_another_phone_shows_takes_no_pose_from_this_one(
    live: LiveGuidance, monkeypatch: pytest.MonkeyPatch
) -> None:
    live.look(frame(HeldPose()), phone="own", taken_s=0.0)
    live.look(frame(HeldPose(), seed=9), phone="other", taken_s=0.1)

    def search(*_: object) -> None:
        raise AssertionError("the whole frame was searched")

    monkeypatch.setattr(TrackingReference, "anchored", search)
    assert live.look(frame(HeldPose()), phone="own", taken_s=0.2).verdict == "go"


def test_a_smaller_frame_of_a_slower_link_is_followed_on(live: LiveGuidance) -> None:
    live.look(frame(HeldPose()))
    found = held(live, frame(HeldPose(), size=(480, 360)))
    assert found.verdict == "go"


def test_a_hand_that_moves_is_told_to_hold_still(stills: Stills) -> None:
    times_s = iter([0.0, 0.2])
    live = LiveGuidance(Judge(GuideReference.read(stills.reference)), clock=lambda: next(times_s))
    live.look(frame(HeldPose(centre=np.array([0.04, 0, 0]))))
    found = live.look(frame(HeldPose()))  # 3 % of the picture in .2 s
    assert found.verdict == "unsure"
    assert "hold still" in found.remedy


def test_only_the_newest_frame_that_waits_is_judged(live: LiveGuidance) -> None:
    async def run() -> list[object]:
        frames = [frame(HeldPose()) for _ in range(4)]
        return list(await asyncio.gather(*(live.judged(one) for one in frames)))

    found = asyncio.run(run())
    # The first is at work when the others come; of those only the last is worth the work.
    assert [one is None for one in found][1:] == [True, True, False]


@pytest.mark.parametrize("size", [(20_000, 20_000), (64, 64), (1025, 480)])
def test_a_frame_of_another_size_is_refused_before_it_is_decoded(
    size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = io.BytesIO()
    Image.new("L", (64, 64)).save(made, "JPEG")
    data = bytearray(made.getvalue())
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = size[1].to_bytes(2, "big") + size[0].to_bytes(2, "big")
    monkeypatch.setattr(cv2, "imdecode", None)
    with pytest.raises(FrameError, match="px a side"):
        decoded_frame(bytes(data))


@pytest.mark.parametrize("marker", [0x01, 0xD0])
def test_a_large_frame_behind_a_marker_without_a_length_is_refused(marker: int) -> None:
    """To a reader that takes the bytes behind it for a length, it is a small frame."""
    large, small = (jpeg(np.zeros(size, np.uint8)) for size in ((2000, 3000), (480, 640)))
    frame_header = small[small.index(b"\xff\xc0") :][:13]
    head = large[:2] + bytes([0xFF, marker]) + large[2:20]  # JFIF's segment, with its ff e0
    at = 4 + 0xFFE0
    comment = bytearray(0xFFFF)
    comment[:2] = (0xFFFF).to_bytes(2, "big")
    place = at - len(head) - 2
    comment[place : place + len(frame_header)] = frame_header
    data = head + b"\xff\xfe" + bytes(comment) + large[20:]
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert decoded is not None
    assert decoded.shape == (2000, 3000)
    with pytest.raises(FrameError, match="JPEG"):
        decoded_frame(data)


def test_a_frame_that_is_decoded_to_another_size_than_it_states_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("standoff.console.guide._live.jpeg_size", lambda _: (640, 480))
    with pytest.raises(FrameError, match="damaged"):
        decoded_frame(jpeg(np.zeros((1000, 1000), np.uint8)))


def test_other_kinds_of_pictures_are_no_frames() -> None:
    made = io.BytesIO()
    Image.new("L", (640, 480)).save(made, "PNG")
    with pytest.raises(FrameError, match="JPEG"):
        decoded_frame(made.getvalue())


@given(st.binary(max_size=200), st.integers(0, 200))
def test_bytes_of_any_kind_are_refused_or_decoded(noise: bytes, at: int) -> None:
    data = jpeg(np.zeros((96, 128), np.uint8))
    for each in (noise, data[:at] + noise + data[at:]):
        with suppress(FrameError):
            assert max(decoded_frame(each).shape) == 640


def test_a_reference_that_cannot_be_followed_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flat.jpg"
    Image.new("L", (640, 480), 90).save(path)
    with pytest.raises(CalibrationError, match=r"flat\.jpg"):
        GuideReference.read(path)
