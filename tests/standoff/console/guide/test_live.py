"""Frames of a phone: hostile ones are refused, the newest is judged, the scene is found again."""

import asyncio
import io
from contextlib import suppress
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
from standoff.console.guide import GuideReference, Judge, LiveGuidance
from standoff.console.guide._live import FrameError, decoded_frame
from tests.standoff.console.guide.scenes import Stills, again_pose, wall

pytestmark = pytest.mark.slow


def frame(pose: HeldPose, seed: int = 1, size: tuple[int, int] = (640, 480)) -> bytes:
    seen = wall(seed).resized(size).seen([pose], np.random.default_rng(5))
    return jpeg(seen)


def jpeg(levels: NDArray[np.uint8]) -> bytes:
    return cv2.imencode(".jpg", levels)[1].tobytes()


@pytest.fixture
def live(stills: Stills) -> LiveGuidance:
    return LiveGuidance(Judge(GuideReference.read(stills.reference)))


def test_from_the_references_pose_it_is_good_and_there_is_no_arrow(live: LiveGuidance) -> None:
    found = live.look(frame(HeldPose()))
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
    blurred = live.look(jpeg(np.asarray(cv2.GaussianBlur(sharp, (0, 0), 6), np.uint8)))
    assert blurred.verdict != "go"
    dark = live.look(jpeg((sharp // 12).astype(np.uint8)))
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
    assert live.look(frame(again_pose())).verdict == "go"


def test_a_smaller_frame_of_a_slower_link_is_followed_on(live: LiveGuidance) -> None:
    live.look(frame(HeldPose()))
    found = live.look(frame(HeldPose(), size=(480, 360)))
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
