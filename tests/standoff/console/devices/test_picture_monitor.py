"""What the console measures on the picture while its frames change or stay away."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition.devices import CameraSettings
from analysis.pose.tracker import PoseVerdict
from simulation.arrays import AnyArray
from standoff.console.devices.frame_broadcaster import FrameBroadcaster, LiveFrame
from standoff.console.devices.picture_monitor import PictureMonitor
from standoff.console.devices.pose_monitor import PoseMonitor
from tests.acquisition.fakes import SETTINGS, frame
from tests.standoff.console.hub_fixtures import DEADLINE_S, wait_for

RNG = np.random.default_rng(4)
STRIPES_DN = 1000 * (np.arange(100) // 9 % 2)
ACCEPTED = PoseVerdict(
    accepted=True,
    verdict="go",
    probability=None,
    dprime=None,
    margin=None,
    reason="",
    homography=None,
    zoom=None,
    overlap=None,
    anchored=False,
)


def live(sequence: int, rows: int, cols: int) -> LiveFrame:
    return LiveFrame(
        image_dn=(RNG.integers(500, 600, (rows, cols)) + STRIPES_DN[:cols]).astype(np.uint16),
        sequence=sequence,
        received_s=float(sequence),
        settings=SETTINGS,
    )


def test_focus_is_measured_anew_when_the_frames_change_their_size() -> None:
    monitor = PictureMonitor(FrameBroadcaster())
    for sequence in range(3):
        monitor.look(live(sequence, 40, 60))
    assert monitor.facts.focus is not None
    assert len(monitor.facts.trace) == 2  # a pair of frames gives a value
    monitor.look(live(3, 60, 40))
    assert monitor.facts.levels is not None
    assert monitor.facts.levels.counts.sum() == 2400
    for sequence in range(4, 6):
        monitor.look(live(sequence, 60, 40))
    assert monitor.facts.focus is not None
    assert len(monitor.facts.trace) == 1  # of the new size alone
    monitor.close()  # though it never began


def test_behind_a_lens_cap_there_is_nothing_to_focus_on() -> None:
    monitor = PictureMonitor(FrameBroadcaster())
    for sequence in range(30):
        dark = replace(
            live(sequence, 60, 80),
            image_dn=np.rint(RNG.normal(64, 3, (60, 80))).astype(np.uint16),
        )
        monitor.look(dark)
        focus = monitor.facts.focus
        assert focus is None or not focus.has_detail
    assert monitor.facts.focus is not None
    assert monitor.facts.trace == ()
    for sequence in range(30, 33):
        monitor.look(live(sequence, 60, 80))
    assert monitor.facts.focus.has_detail


def test_without_new_pictures_there_is_no_verdict_on_the_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Accepting:
        is_searching = False

        def update(self, _: AnyArray) -> PoseVerdict:
            return ACCEPTED

    monkeypatch.setattr("standoff.console.devices.pose_monitor.PERIOD_S", 0.001)
    monkeypatch.setattr("standoff.console.devices.pose_monitor.STALE_S", DEADLINE_S)
    broadcaster = FrameBroadcaster()
    monitor = PoseMonitor(broadcaster, lambda _: Accepting())  # type: ignore[arg-type,return-value]  # stands for a tracker
    monitor.start()
    try:
        monitor.choose("before", np.zeros((4, 6), np.uint16))
        broadcaster.publish(frame(700, 1), SETTINGS)
        wait_for(lambda: monitor.view.verdict is not None, "a verdict")
        monkeypatch.setattr("standoff.console.devices.pose_monitor.STALE_S", 0.01)
        broadcaster.publish(frame(700, 2), SETTINGS)  # the last one
        wait_for(lambda: monitor.view.verdict is None, "no verdict on an old picture")
        assert monitor.view.reference == "before"
    finally:
        monitor.close()


def test_a_verdict_on_the_last_reference_is_not_shown_for_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class ChoosesAnother:
        is_searching = False

        def update(self, _: AnyArray) -> PoseVerdict:
            if monitor.view.reference == "first":
                monitor.choose("second", np.zeros((4, 6), np.uint16))
                judged.append("first")
            return ACCEPTED

    judged: list[str] = []
    monkeypatch.setattr("standoff.console.devices.pose_monitor.PERIOD_S", 0.001)
    monkeypatch.setattr("standoff.console.devices.pose_monitor.STALE_S", DEADLINE_S)
    broadcaster = FrameBroadcaster()
    monitor = PoseMonitor(broadcaster, lambda _: ChoosesAnother())  # type: ignore[arg-type,return-value]  # stands for a tracker
    monitor.choose("first", np.zeros((4, 6), np.uint16))
    monitor.start()
    try:
        broadcaster.publish(frame(700, 1), SETTINGS)
        wait_for(lambda: bool(judged), "the first one judged")
        assert (monitor.view.reference, monitor.view.verdict) == ("second", None)
        broadcaster.publish(frame(700, 2), SETTINGS)
        wait_for(lambda: monitor.view.verdict is not None, "a verdict on the second")
        assert monitor.view.reference == "second"
    finally:
        monkeypatch.setattr("standoff.console.devices.pose_monitor.STALE_S", 0.01)
        broadcaster.publish(frame(700, 3), SETTINGS)
        monitor.close()


def test_a_watch_that_never_began_may_be_closed() -> None:
    PoseMonitor(FrameBroadcaster(), None).close()


def scene(sequence: int, light: float, settings: CameraSettings = SETTINGS) -> LiveFrame:
    """Faint stripes, in which noise is a good part of the gradient, under some light."""
    stripes = 1200 + 240 * np.sin(np.arange(200) / 3) * np.ones((160, 1))
    image = settings.black_level_dn + light * stripes
    noisy = RNG.normal(image, np.sqrt(light * stripes / 4))
    return LiveFrame(
        image_dn=np.clip(np.rint(noisy), 0, 4095).astype(np.uint16),
        sequence=sequence,
        received_s=0.2 * sequence,
        settings=settings,
    )


@pytest.mark.slow
@pytest.mark.parametrize("light", [0.25, 0.5, 1.5, 2.5])
@pytest.mark.parametrize("is_told", [True, False])
def test_a_step_of_exposure_or_light_makes_no_peak(light: float, is_told: bool) -> None:
    monitor = PictureMonitor(FrameBroadcaster())
    changed = replace(SETTINGS, exposure_us=light * SETTINGS.exposure_us) if is_told else SETTINGS
    frames = [scene(number, 1.0) for number in range(30)]
    # The first frames after the setting still have the old exposure.
    frames += [scene(number, 1.0, changed) for number in range(30, 33)]
    frames += [scene(number, light, changed) for number in range(33, 70)]
    for frame_ in frames:
        monitor.look(frame_)
        focus = monitor.facts.focus
        assert focus is None or not focus.is_past_peak
    assert focus is not None
    assert focus.percent_of_peak > 80
    # Values of before the step are gone, with their times.
    assert len(monitor.facts.trace) == len(monitor.facts.trace_s)
    assert monitor.facts.trace_s[0] > -0.2 * 37
