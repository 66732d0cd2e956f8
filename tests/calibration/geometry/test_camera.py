import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from calibration.geometry import PlaneLens
from calibration.geometry._bundle_adjustment import CapturePose
from hil_mocks.truth.render import CameraPose
from tests.calibration.geometry_bench import FOCAL_PX, HEIGHT_PX, PUPIL_MM, WIDTH_PX, pinhole

GRID_PX = np.array([(x, y) for x in (0.0, 97.0, 389.0) for y in (0.0, 151.0, 289.0)])


def lens(**values: float) -> PlaneLens:
    return PlaneLens(width_px=WIDTH_PX, height_px=HEIGHT_PX, focal_length_px=FOCAL_PX, **values)


@given(
    k1=st.floats(-0.1, 0.1),
    k2=st.floats(-0.01, 0.01),
    principal=st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
    tilt=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
)
def test_slopes_and_pixels_are_inverse(
    k1: float, k2: float, principal: tuple[float, float], tilt: tuple[float, float]
) -> None:
    camera = lens(
        k1=k1,
        k2=k2,
        principal_x_px=principal[0],
        principal_y_px=principal[1],
        tilt_x_rad=tilt[0],
        tilt_y_rad=tilt[1],
    )
    # Beyond the fold of a strong barrel the lens shows nothing: no plane point is seen there.
    radius = np.hypot(*(GRID_PX - camera.principal_px).T).max() / camera.corner_radius_px
    ideal = np.linspace(0.0, 3.0, 3001)
    assume(np.max(ideal * (1 + k1 * ideal**2 + k2 * ideal**4)) > radius)
    np.testing.assert_allclose(camera.pixels(camera.slopes(GRID_PX)), GRID_PX, atol=1e-7)


def test_a_pixel_that_the_lens_cannot_show_has_finite_slopes_and_changes() -> None:
    # The corner lies 1.12 corners from the principal point; this lens shows 1.09.
    camera = lens(k1=-0.1, k2=-0.01, principal_x_px=20.0, principal_y_px=20.0)
    corner = GRID_PX[:1]
    assert np.isfinite(camera.slopes(corner)).all()
    assert np.isfinite(camera.slope_changes(corner)).all()


def test_a_plane_point_beyond_the_fold_is_not_seen_in_the_frame() -> None:
    # Ideally 3 corners out: r (1 - 0.1 r^2) would bring it back to 0.3.
    camera = lens(k1=-0.1)
    slopes = 3.0 * camera.corner_radius_px / FOCAL_PX * np.array([[0.8, 0.6]])
    away_px = np.hypot(*(camera.pixels(slopes) - camera.principal_px)[0])
    assert away_px > camera.corner_radius_px


@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (2.0, 0.0), (0.0, -3.0), (1.5, 1.0)])
def test_it_sees_what_the_bench_sees(tilt_deg: tuple[float, float]) -> None:
    # Closed form that shares no code: the bench's own pinhole.
    bench = pinhole(k1=-0.02)
    pose = CameraPose(
        height_mm=200.0,
        offset_x_mm=3.0,
        offset_y_mm=-2.0,
        tilt_x_deg=tilt_deg[0],
        tilt_y_deg=tilt_deg[1],
    )
    expected = np.column_stack(bench.to_plane_mm(GRID_PX[:, 0], GRID_PX[:, 1], pose))
    camera = lens(
        k1=-0.02,
        tilt_x_rad=float(np.deg2rad(tilt_deg[0])),
        tilt_y_rad=float(np.deg2rad(tilt_deg[1])),
    )
    own = CapturePose(log_distance=float(np.log(200.0 + PUPIL_MM)), x=3.0, y=-2.0)
    np.testing.assert_allclose(own.plane(camera.slopes(GRID_PX)), expected, atol=1e-9)
    np.testing.assert_allclose(camera.pixels(own.slopes(expected)), GRID_PX, atol=1e-7)


def test_a_turn_goes_from_x_towards_y() -> None:
    pose = CapturePose(turn_rad=np.pi / 2, log_distance=float(np.log(10.0)))
    np.testing.assert_allclose(pose.plane(np.array([[1.0, 0.0]])), [[0.0, 10.0]], atol=1e-12)


def test_a_barrel_draws_the_corner_inwards() -> None:
    corner = np.array([[WIDTH_PX - 1.0, HEIGHT_PX - 1.0]])
    ideal = lens().slopes(corner)
    seen = lens(k1=-0.01).pixels(ideal)
    middle = np.array([(WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2])
    # By definition: 1 % of the corner's radius.
    np.testing.assert_allclose(seen - middle, 0.99 * (corner - middle), atol=1e-9)
