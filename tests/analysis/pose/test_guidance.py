"""The deviation of a hand-held camera, against poses that are built from their angles here."""

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from analysis.pose import TOLERANCES, PoseDeviation, pose_deviation

SIZE, REFERENCE = (640, 480), (1280, 960)
FOCAL = 0.8


def turned(right_deg: float, down_deg: float, clockwise_deg: float) -> NDArray[np.float64]:
    """Axes of a camera in the reference's, as columns: first swung, then turned about its axis."""
    a, b, c = np.radians([right_deg, down_deg, clockwise_deg])
    about_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), np.sin(b)], [0, -np.sin(b), np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return np.asarray(about_y @ about_x @ about_z)


def homography(
    axes: NDArray[np.float64], centre: tuple[float, float, float]
) -> NDArray[np.float64]:
    """Frame to reference pixels, by where the two see four points of the plane."""
    points = np.array([[-0.3, -0.2, 1], [0.4, -0.3, 1], [0.35, 0.3, 1], [-0.3, 0.25, 1]])
    seen = (points - centre) @ axes
    frame = FOCAL * SIZE[0] * seen[:, :2] / seen[:, 2:] + [(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2]
    near = FOCAL * REFERENCE[0] * points[:, :2] + [(REFERENCE[0] - 1) / 2, (REFERENCE[1] - 1) / 2]
    return np.asarray(
        cv2.getPerspectiveTransform(frame.astype(np.float32), near.astype(np.float32)), np.float64
    )


def deviation(
    axes: NDArray[np.float64], centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> PoseDeviation:
    return pose_deviation(homography(axes, centre), SIZE, REFERENCE)


def test_at_the_reference_there_is_nothing_to_do() -> None:
    found = deviation(turned(0, 0, 0))
    assert found.distance == pytest.approx(1, abs=1e-5)
    assert found.largest_cost < 0.01
    assert found.arrows() == ()


@pytest.mark.parametrize(
    ("axes", "centre", "words"),
    [
        (turned(0, 0, 0), (0, 0, -0.2), ["nearer 20 %"]),
        (turned(0, 0, 0), (0, 0, 0.1), ["further 10 %"]),
        # A camera that stands right of the reference has to move left.
        (turned(0, 0, 0), (0.1, 0, 0), ["left 8 % of the picture"]),
        (turned(0, 0, 0), (0, 0.1, 0), ["up 8 % of the picture"]),
        (turned(0, 0, 10), (0, 0, 0), ["turn anticlockwise 10°"]),
        (turned(0, 0, -10), (0, 0, 0), ["turn clockwise 10°"]),
    ],
)
def test_one_movement_is_told_as_what_undoes_it(
    axes: NDArray[np.float64], centre: tuple[float, float, float], words: list[str]
) -> None:
    assert [arrow.words for arrow in deviation(axes, centre).arrows()] == words


@pytest.mark.parametrize(
    ("right", "down", "name"),
    [(6, 0, "tilt left"), (-6, 0, "tilt right"), (0, 6, "tilt up"), (0, -6, "tilt down")],
)
def test_a_camera_that_is_swung_is_told_to_swing_back(right: int, down: int, name: str) -> None:
    # It stands where its swung axis still meets the middle of the scene.
    axes = turned(right, down, 0)
    centre = np.array([0, 0, 1]) - axes[:, 2]
    found = deviation(axes, (centre[0], centre[1], centre[2]))
    assert [arrow.words for arrow in found.arrows()] == [f"{name} 6°"]
    assert found.costs["aim"] < 0.01
    assert found.distance == pytest.approx(1, abs=1e-4)


@given(
    st.floats(-15, 15), st.floats(-15, 15), st.floats(-30, 30), st.floats(-0.15, 0.15),
    st.floats(-0.15, 0.15), st.floats(-0.3, 0.3),
)  # fmt: skip
def test_what_is_told_is_how_the_camera_stands(
    right: float, down: float, clockwise: float, x: float, y: float, nearer: float
) -> None:
    axes = turned(right, down, clockwise)
    found = deviation(axes, (x, y, nearer))
    axis = axes[:, 2]
    assert found.distance == pytest.approx((1 - nearer) / axis[2], rel=1e-3)
    back = axes.T @ [0, 0, 1]
    assert found.tilt_right_deg == pytest.approx(np.degrees(np.arctan2(back[0], back[2])), abs=0.05)
    assert found.tilt_down_deg == pytest.approx(np.degrees(np.arctan2(back[1], back[2])), abs=0.05)
    seen = axes.T @ (np.array([0, 0, 1]) - (x, y, nearer))
    assert found.right == pytest.approx(FOCAL * seen[0] / seen[2], abs=1e-3)
    assert found.down == pytest.approx(FOCAL * seen[1] / seen[2], abs=1e-3)
    assert len(found.arrows()) <= 2
    if any(cost > 1 for cost in found.costs.values()):
        assert found.arrows()


def test_the_largest_deviations_in_units_of_their_tolerances_come_first() -> None:
    found = PoseDeviation(
        distance=1 + 4 * TOLERANCES["distance"],
        right=3 * TOLERANCES["aim"],
        down=0,
        clockwise_deg=5 * TOLERANCES["turn"],
        tilt_right_deg=0,
        tilt_down_deg=0,
    )
    assert [arrow.name for arrow in found.arrows()] == ["turn clockwise", "nearer"]
    assert found.largest_cost == pytest.approx(5)
    assert found.sentence == (
        "12 % further away, aside by 6 % of the picture, turned by 10°, tilted by 0°"
    )


def test_a_scene_that_is_about_to_be_lost_is_aimed_at_first() -> None:
    found = PoseDeviation(
        distance=2.0, right=0.31, down=0, clockwise_deg=0, tilt_right_deg=0, tilt_down_deg=0
    )
    assert [arrow.name for arrow in found.arrows()] == ["right", "nearer"]


SINGULAR = np.zeros((3, 3))
MIRRORED = np.array([[-2.0, 0, 1279], [0, 2, 0], [0, 0, 1]])


@pytest.mark.parametrize("matrix", [SINGULAR, MIRRORED])
def test_what_no_camera_sees_is_refused(matrix: NDArray[np.float64]) -> None:
    with pytest.raises((ValueError, np.linalg.LinAlgError)):
        pose_deviation(matrix, SIZE, REFERENCE)
