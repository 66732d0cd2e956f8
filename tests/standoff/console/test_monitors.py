"""What is measured in the live picture: focus, sharpness and squareness, and the pose."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.special import erf

from acquisition.devices import CameraSettings, FrameImage
from acquisition.focus import Region
from analysis.pose._tracker import PoseVerdict
from calibration.edges import EdgeImage, EdgeMeasurement, edges_of_image
from calibration.geometry import DEFAULT_BOARD
from simulation.arrays import AnyArray
from standoff.console.edge_reading import count_edges, read_edge
from standoff.console.frames import FrameBroadcaster, LiveFrame
from standoff.console.monitors import (
    PictureMonitor,
    PoseMonitor,
    SharpnessMonitor,
    SquarenessMonitor,
    SquarenessView,
    field_regions,
)
from standoff.console.web._view_model import measure_document
from tests.acquisition.fakes import SETTINGS, frame
from tests.standoff.console.hub_fixtures import DEADLINE_S, pose_verdict, wait_for

RNG = np.random.default_rng(4)
STRIPES_DN = 1000 * (np.arange(100) // 9 % 2)
ACCEPTED = pose_verdict()


def striped(sequence: int, rows: int, cols: int) -> LiveFrame:
    return LiveFrame(
        image_dn=(RNG.integers(500, 600, (rows, cols)) + STRIPES_DN[:cols]).astype(np.uint16),
        sequence=sequence,
        received_s=float(sequence),
        settings=SETTINGS,
    )


def test_focus_is_measured_anew_when_the_frames_change_their_size() -> None:
    monitor = PictureMonitor(FrameBroadcaster())
    for sequence in range(3):
        monitor.look(striped(sequence, 40, 60))
    assert monitor.facts.focus is not None
    assert len(monitor.facts.trace) == 2  # a pair of frames gives a value
    monitor.look(striped(3, 60, 40))
    assert monitor.facts.levels is not None
    assert monitor.facts.levels.counts.sum() == 2400
    for sequence in range(4, 6):
        monitor.look(striped(sequence, 60, 40))
    assert monitor.facts.focus is not None
    assert len(monitor.facts.trace) == 1  # of the new size alone
    monitor.close()  # though it never began


def test_behind_a_lens_cap_there_is_nothing_to_focus_on() -> None:
    monitor = PictureMonitor(FrameBroadcaster())
    for sequence in range(30):
        dark = replace(
            striped(sequence, 60, 80),
            image_dn=np.rint(RNG.normal(64, 3, (60, 80))).astype(np.uint16),
        )
        monitor.look(dark)
        focus = monitor.facts.focus
        assert focus is None or not focus.has_detail
    assert monitor.facts.focus is not None
    assert monitor.facts.trace == ()
    for sequence in range(30, 33):
        monitor.look(striped(sequence, 60, 80))
    assert monitor.facts.focus.has_detail


def test_without_new_pictures_there_is_no_verdict_on_the_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Accepting:
        is_searching = False

        def update(self, _: AnyArray) -> PoseVerdict:
            return ACCEPTED

    monkeypatch.setattr(PoseMonitor, "period_s", 0.001)
    monkeypatch.setattr(PoseMonitor, "patience_s", DEADLINE_S)
    broadcaster = FrameBroadcaster()
    monitor = PoseMonitor(broadcaster, lambda _: Accepting())  # type: ignore[arg-type,return-value]  # stands for a tracker
    monitor.start()
    try:
        monitor.choose("before", np.zeros((4, 6), np.uint16))
        broadcaster.publish(frame(700, 1), SETTINGS)
        wait_for(lambda: monitor.view.verdict is not None, "a verdict")
        monkeypatch.setattr(PoseMonitor, "patience_s", 0.01)
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
    monkeypatch.setattr(PoseMonitor, "period_s", 0.001)
    monkeypatch.setattr(PoseMonitor, "patience_s", DEADLINE_S)
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
        monkeypatch.setattr(PoseMonitor, "patience_s", 0.01)
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


ROWS, COLS = 120, 160
WHOLE = Region(x_px=0, y_px=0, width_px=COLS, height_px=ROWS)
PITCH_UM = 8.3


def edge_frame(
    sigma_px: float, angle_deg: float, *, sequence: int = 1, bright: float = 2500.0
) -> LiveFrame:
    """A Gaussian edge, integrated over pixels by sampling each at 9 x 9 places; with shot noise."""
    rng = np.random.default_rng(round(1000 * sigma_px + angle_deg) + sequence)
    inside = (np.arange(9) - 4) / 9
    y = np.arange(ROWS)[:, None, None, None] + inside[None, None, :, None] - ROWS / 2
    x = np.arange(COLS)[None, :, None, None] + inside[None, None, None, :] - COLS / 2
    normal = np.deg2rad(angle_deg + 90)
    distance = x * np.cos(normal) + y * np.sin(normal)
    share = (0.5 + 0.5 * erf(distance / sigma_px / np.sqrt(2))).mean(axis=(2, 3))
    light = 200 + (bright - 200) * share
    levels = rng.normal(SETTINGS.black_level_dn + light, np.sqrt(light / 5))
    return live(np.clip(np.rint(levels), 0, 4095).astype(np.uint16), sequence)


def live(image_dn: FrameImage, sequence: int = 1, pixel_format: str = "Mono12") -> LiveFrame:
    rows, cols = image_dn.shape
    return LiveFrame(
        image_dn=image_dn,
        sequence=sequence,
        received_s=0.125 * sequence,
        settings=replace(SETTINGS, height_px=rows, width_px=cols, pixel_format=pixel_format),
    )


@pytest.mark.parametrize("sigma_px", [0.55, 0.9, 2.0])
@pytest.mark.parametrize("angle_deg", [5.0, 50.0, 95.0])
def test_the_edge_of_one_frame_has_the_width_it_was_made_with(
    sigma_px: float, angle_deg: float
) -> None:
    reading, why_not = read_edge(edge_frame(sigma_px, angle_deg), WHOLE, PITCH_UM)
    assert why_not == ""
    assert reading is not None
    # With the pixel square, whose variance is 1/12; together they are no Gaussian any more.
    total_px = np.sqrt(sigma_px**2 + 1 / 12)
    assert reading.sigma_px == pytest.approx(total_px, rel=0.01)
    assert 0 < reading.sigma_err_px < 0.02
    turned = (reading.angle_deg - angle_deg + 90) % 180 - 90
    assert turned == pytest.approx(0, abs=0.2)
    # A Gaussian's MTF times the pixel's: closed form.
    freq = np.linspace(0.01, 1, 20_000)
    normal = np.deg2rad(angle_deg + 90)
    pixel = np.abs(np.sinc(freq * np.cos(normal)) * np.sinc(freq * np.sin(normal)))
    mtf = pixel * np.exp(-2 * (np.pi * sigma_px * freq) ** 2)
    half = float(freq[np.argmin(np.abs(mtf - 0.5))])
    assert reading.mtf50_cy_per_px == pytest.approx(half, rel=0.02)
    assert reading.mtf50_lp_per_mm == pytest.approx(1000 * reading.mtf50_cy_per_px / PITCH_UM)
    assert reading.levels[0] == pytest.approx(0, abs=0.05)
    assert reading.levels[-1] == pytest.approx(1, abs=0.05)
    assert np.all(np.diff(reading.distance_px) > 0)


def crossed_frame(edges: int) -> LiveFrame:
    """Edges across a frame of 400 columns, 60 rows apart; long ones are measured in pieces."""
    rng = np.random.default_rng(edges)
    y, x = np.mgrid[: 60 * (edges + 1), :400]
    share = np.zeros(y.shape)
    for number in range(edges):
        side = (-1) ** number
        distance = y - 60 * (number + 1) - np.tan(np.deg2rad(3)) * (x - 200)
        share += side * (0.5 + 0.5 * erf(distance / 0.8 / np.sqrt(2)))
    light = 200 + 2300 * share
    levels = rng.normal(SETTINGS.black_level_dn + light, np.sqrt(light / 5))
    return live(np.clip(np.rint(levels), 0, 4095).astype(np.uint16))


@pytest.mark.parametrize("edges", [1, 2])
def test_a_long_edge_is_one_and_the_sides_of_a_bar_are_two(edges: int) -> None:
    made = crossed_frame(edges)
    rows, cols = made.image_dn.shape
    whole = Region(x_px=0, y_px=0, width_px=cols, height_px=rows)
    assert sum(edge.is_used for edge in measured_edges(edges)) > edges  # in pieces
    reading, _ = read_edge(made, whole, PITCH_UM)
    assert reading is not None
    assert reading.edges == edges


def test_pieces_count_once_in_whatever_order_they_come() -> None:
    one = measured_edges(1)
    assert count_edges(one) == count_edges(one[::-1]) == 1
    assert count_edges([one[0], one[-1]]) == 2  # with a gap between them
    assert count_edges([]) == 0


def measured_edges(edges: int) -> list[EdgeMeasurement]:
    image_dn = crossed_frame(edges).image_dn.astype(np.float64) - SETTINGS.black_level_dn
    found = edges_of_image(EdgeImage(name="live", image_dn=image_dn, saturation_dn=4095.0))
    return sorted(found, key=lambda edge: edge.x_px)


def test_a_colour_camera_is_measured_on_green() -> None:
    sigma_px = 1.2
    grey = edge_frame(sigma_px, 5.0)
    mosaic = grey.image_dn.copy()
    mosaic[0::2, 0::2] //= 2  # red: another level, which would be an edge at every pixel
    mosaic[1::2, 1::2] //= 3
    for x_px in (0, 1):
        region = Region(x_px=x_px, y_px=1, width_px=COLS - 2, height_px=ROWS - 2)
        reading, _ = read_edge(live(mosaic, pixel_format="BayerRG12"), region, PITCH_UM)
        assert reading is not None
        assert reading.sigma_px == pytest.approx(np.sqrt(sigma_px**2 + 1 / 12), rel=0.02)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.full((ROWS, COLS), 1000, np.uint16), "no straight edge"),
        (edge_frame(0.7, 5.0, bright=40_000.0).image_dn, "saturated"),
    ],
)
def test_where_nothing_can_be_measured_the_page_says_why(image: FrameImage, words: str) -> None:
    reading, why_not = read_edge(live(image), WHOLE, PITCH_UM)
    assert reading is None
    assert words in why_not
    outside = Region(x_px=0, y_px=0, width_px=COLS + 1, height_px=ROWS)
    assert "outside the picture" in read_edge(live(image), outside, PITCH_UM)[1]


def test_the_monitor_measures_what_is_asked_for_and_nothing_else() -> None:
    monitor = SharpnessMonitor(FrameBroadcaster(), PITCH_UM)
    monitor.look(edge_frame(0.7, 5.0))
    assert monitor.view.sequence == 0
    monitor.look_at(WHOLE)
    for sequence in range(1, 10):
        monitor.look(edge_frame(0.7, 5.0, sequence=sequence))
    assert monitor.view.edge is not None
    assert monitor.view.rate_hz == pytest.approx(8)
    assert monitor.view.field == ()
    before = monitor.view.sequence
    monitor.look_at(None)
    assert monitor.view.edge is None
    assert monitor.view.sequence > before  # so that pages are told


def test_the_four_regions_have_peaks_of_their_own_until_the_exposure_changes() -> None:
    monitor = SharpnessMonitor(FrameBroadcaster(), PITCH_UM)
    monitor.watch_field(True)
    sharp = texture(1)
    soft = sharp.copy()
    soft[: ROWS // 2] = soft[: ROWS // 2] // 8 + 1200  # the upper half has an eighth of the detail
    monitor.look(live(sharp, 1))
    assert {round(each.percent_of_peak, 9) for each in monitor.view.field} == {100.0}
    monitor.look(live(soft, 2))
    percent = {each.name: each.percent_of_peak for each in monitor.view.field}
    assert percent["top left"] < 20 > percent["top right"]
    assert percent["bottom left"] == percent["bottom right"] == 100
    dim = replace(live(soft, 3), settings=replace(SETTINGS, exposure_us=1.0))
    monitor.look(dim)
    assert {round(each.percent_of_peak, 9) for each in monitor.view.field} == {100.0}


def test_an_edge_is_awaited_from_the_choice_of_its_region_to_the_first_measurement() -> None:
    monitor = SharpnessMonitor(FrameBroadcaster(), PITCH_UM)
    assert not monitor.view.is_awaited
    monitor.look_at(WHOLE)
    assert measure_document(monitor.view, SquarenessView(), has_field=False)["is_awaited"]
    monitor.look(edge_frame(0.9, 5.0))
    assert not monitor.view.is_awaited
    monitor.look_at(None)
    assert not monitor.view.is_awaited


def texture(seed: int) -> FrameImage:
    """Detail three pixels wide, as behind a lens."""
    coarse = np.random.default_rng(seed).integers(500, 3000, (ROWS // 3, COLS // 3 + 1))
    fine: FrameImage = np.kron(coarse, np.ones((3, 3))).astype(np.uint16)
    return fine[:ROWS, :COLS]


def paper(seed: int) -> FrameImage:
    """White paper under light that falls off by 30 % to the corners, with shot noise."""
    y, x = np.mgrid[:ROWS, :COLS]
    away = ((y - ROWS / 2) ** 2 + (x - COLS / 2) ** 2) / (ROWS**2 + COLS**2) * 4
    light = 2000.0 * (1 - 0.3 * away)
    levels = np.random.default_rng(seed).normal(SETTINGS.black_level_dn + light, np.sqrt(light / 5))
    return np.asarray(np.rint(levels), dtype=np.uint16)


def test_four_regions_of_bare_paper_say_that_there_is_no_edge() -> None:
    monitor = SharpnessMonitor(FrameBroadcaster(), PITCH_UM)
    monitor.watch_field(True)
    for sequence in range(1, 9):
        monitor.look(live(paper(sequence), sequence))
        assert not any(each.has_detail for each in monitor.view.field)
        assert all(each.edge is None for each in monitor.view.field)
    document = measure_document(monitor.view, SquarenessView(), has_field=True)
    assert [corner["percent"] for corner in document["field"]] == ["–"] * 4
    assert [corner["why_not"] for corner in document["field"]] == ["no edge"] * 4
    # What the noise was is no peak for what comes next.
    monitor.look(live(texture(1), 9))
    assert {round(each.percent_of_peak, 9) for each in monitor.view.field} == {100.0}


def test_a_region_over_texture_gives_no_width() -> None:
    reading, why_not = read_edge(live(texture(3)), WHOLE, PITCH_UM)
    assert reading is None
    assert "no straight edge" in why_not


def test_remarks_on_the_edge_are_shown_beside_its_width() -> None:
    frame = edge_frame(0.9, 5.0)
    frame.image_dn[ROWS // 2 + 3, 60:100:10] = 200  # specks of dust
    monitor = SharpnessMonitor(FrameBroadcaster(), PITCH_UM)
    monitor.look_at(WHOLE)
    monitor.look(frame)
    assert monitor.view.edge is not None
    assert "outliers" in monitor.view.edge.flags
    document = measure_document(monitor.view, SquarenessView(), has_field=False)
    assert "outliers" in document["edge"]["remarks"]


@pytest.mark.parametrize("shape", [(580, 780), (48, 64), (16, 16)])
def test_the_four_regions_lie_within_the_frame_and_apart(shape: tuple[int, int]) -> None:
    regions = field_regions(shape)
    seen = np.zeros(shape, int)
    for region in regions.values():
        assert region.cut(seen).shape == (region.height_px, region.width_px)
        region.cut(seen)[...] += 1
    assert seen.max() == 1
    assert list(regions) == ["top left", "top right", "bottom left", "bottom right"]


BOARD_ROWS, BOARD_COLS, FOCAL_PX = 580, 780, 960.0


def board_frame(tilt_right_deg: float) -> LiveFrame:
    """The board on a plane 300 mm away whose right side is further away."""
    layout = cv2.aruco.CharucoBoard(
        (DEFAULT_BOARD.columns, DEFAULT_BOARD.rows),
        DEFAULT_BOARD.square_mm,
        DEFAULT_BOARD.marker_mm,
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{DEFAULT_BOARD.dictionary}")),
    )
    px_per_mm = 16
    size_mm = np.array([DEFAULT_BOARD.columns, DEFAULT_BOARD.rows]) * DEFAULT_BOARD.square_mm
    flat = layout.generateImage(tuple(round(v * px_per_mm) for v in size_mm))
    away_mm = 0.75 * FOCAL_PX * size_mm[0] / BOARD_COLS * 1.6
    tilt = np.deg2rad(tilt_right_deg)
    centre = size_mm / 2
    first = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
    second = np.array([0.0, 1.0, 0.0])
    origin = np.array([0.0, 0.0, away_mm]) - centre[0] * first - centre[1] * second
    camera = np.array(
        [[FOCAL_PX, 0, (BOARD_COLS - 1) / 2], [0, FOCAL_PX, (BOARD_ROWS - 1) / 2], [0, 0, 1]]
    )
    matrix = (
        camera
        @ np.column_stack([first, second, origin])
        @ np.diag([1 / px_per_mm, 1 / px_per_mm, 1])
    )
    big = np.diag([4.0, 4.0, 1.0])
    big[0, 2] = big[1, 2] = 1.5  # centres of pixels at integers, four times as fine
    seen = cv2.warpPerspective(
        flat, big @ matrix, (4 * BOARD_COLS, 4 * BOARD_ROWS), borderValue=255
    )
    fine = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), 2.4)
    image = fine.reshape(BOARD_ROWS, 4, BOARD_COLS, 4).mean(axis=(1, 3)) * 10 + 300
    noisy = np.random.default_rng(3).normal(image, 8)
    return LiveFrame(
        image_dn=np.rint(noisy).astype(np.uint16), sequence=1, received_s=1.0, settings=SETTINGS
    )


@pytest.mark.slow
@pytest.mark.parametrize("tilt_right_deg", [-2.0, 0.0, 0.7])
def test_the_tilt_to_a_board_is_shown_with_the_side_to_raise(tilt_right_deg: float) -> None:
    monitor = SquarenessMonitor(FrameBroadcaster(), DEFAULT_BOARD, FOCAL_PX)
    monitor.watch(True)
    monitor.look(board_frame(tilt_right_deg))
    found = monitor.view.levelling
    assert found is not None, monitor.view.why_not
    # Corners of an image are found to some hundredths of a pixel, with an error of some that a
    # board image of limited resolution adds.
    assert found.right_deg == pytest.approx(tilt_right_deg, abs=0.15)
    assert found.down_deg == pytest.approx(0, abs=0.15)
    side = {-1: "right", 1: "left"}.get(int(np.sign(tilt_right_deg)))
    assert (found.advice == "level") if side is None else (f"raise the {side} side" in found.advice)


def test_without_a_board_the_page_says_so_and_nothing_is_shown_once_it_is_off() -> None:
    monitor = SquarenessMonitor(FrameBroadcaster(), DEFAULT_BOARD, FOCAL_PX)
    monitor.watch(True)
    blank = LiveFrame(
        image_dn=np.full((BOARD_ROWS, BOARD_COLS), 900, np.uint16),
        sequence=1,
        received_s=1.0,
        settings=SETTINGS,
    )
    monitor.look(blank)
    assert "board" in monitor.view.why_not
    monitor.watch(False)
    monitor.look(blank)
    assert monitor.view.why_not == ""
