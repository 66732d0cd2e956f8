import pytest

from calibration.sharpness import position_in_field
from tests.calibration.sharpness.edges import edge_of


@pytest.mark.parametrize(
    ("place", "corner"),
    [
        ((0.0, 0.0), "top left"),
        ((100.0, 0.0), "top right"),
        ((0.0, 80.0), "bottom left"),
        ((100.0, 80.0), "bottom right"),
    ],
)
def test_a_corner_is_one_half_diagonal_from_the_centre(
    place: tuple[float, float], corner: str
) -> None:
    found = position_in_field(edge_of(x_px=place[0], y_px=place[1]), 101, 81)
    assert found.radius == pytest.approx(1.0)
    assert found.corner == corner


@pytest.mark.parametrize(
    ("place", "angle_deg", "direction"),
    [
        # To the right of the centre a vertical edge has its normal along the radius.
        ((90.0, 40.0), 90.0, "meridional"),
        ((90.0, 40.0), 0.0, "sagittal"),
        ((50.0, 5.0), 0.0, "meridional"),
        ((50.0, 5.0), 90.0, "sagittal"),
        # Right and below, y down: the radius runs at 45 degrees, an edge across it at 135.
        ((80.0, 70.0), 135.0, "meridional"),
        ((80.0, 70.0), 45.0, "sagittal"),
        ((20.0, 70.0), 45.0, "meridional"),
        ((50.0, 40.0), 90.0, None),
    ],
)
def test_an_edge_across_the_radius_is_meridional_and_one_along_it_sagittal(
    place: tuple[float, float], angle_deg: float, direction: str | None
) -> None:
    found = position_in_field(edge_of(angle_deg, x_px=place[0], y_px=place[1]), 101, 81)
    assert found.direction == direction
