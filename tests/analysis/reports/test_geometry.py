from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure

from analysis.reports import geometry_sections, geometry_verdicts, png_bytes
from analysis.reports._geometry import (
    plot_distortion,
    plot_scale_by_height,
    plot_squareness,
    plot_travel,
)
from calibration.geometry import CaptureGeometry, GeometryCalibration

HEIGHTS = (100.0, 150.0, 200.0)


def stored(**changes: object) -> GeometryCalibration:
    captures = [
        CaptureGeometry(
            image=f"{height:g}.tif", kind="board", target="board", height_mm=height,
            scale_px_per_mm=1000 / (height + 10), scale_err_px_per_mm=1e-4,
            height_residual_mm=0.001, sideways_mm=(0.001, -0.002), matches=70, rms_px=0.01,
        )
        for height in HEIGHTS
    ]  # fmt: skip
    values = {
        "heights_mm": HEIGHTS,
        "scale_px_per_mm": [1000 / (h + 10) for h in HEIGHTS],
        "pupil_offset_mm": 10.0,
        "k1": -0.01,
        "k2": 0.001,
        "tilt_deg": 1.0,
        "tilt_x_deg": 0.6,
        "tilt_y_deg": -0.8,
        "tilt_x_err_deg": 0.01,
        "tilt_y_err_deg": 0.01,
        "axis_drift_px_per_mm": 0.1,
        "focal_length_px": 1000.0,
        "width_px": 780,
        "height_px": 580,
        "captures": captures,
        **changes,
    }
    return GeometryCalibration.model_validate(values)


@pytest.mark.parametrize(
    "plot", [plot_scale_by_height, plot_distortion, plot_squareness, plot_travel]
)
def test_every_axis_has_a_unit(plot: Callable[[GeometryCalibration], Figure | None]) -> None:
    figure = plot(stored())
    assert figure is not None
    assert png_bytes(figure).startswith(b"\x89PNG")
    for axes in figure.axes:
        label = axes.get_ylabel() + axes.get_xlabel()
        assert any(unit in label for unit in ("px", "mm", "µm", "deg"))


def test_the_plotted_scales_are_those_of_the_captures() -> None:
    figure = plot_scale_by_height(stored())
    points = next(line for line in figure.axes[0].lines if line.get_label() == "board")
    # The height less its residual of 1 um: by hand.
    assert np.asarray(points.get_ydata()).tolist() == pytest.approx(
        [1000 / (h - 0.001 + 10) for h in HEIGHTS]
    )


def test_what_is_printed_after_a_value_is_half_its_95_percent_interval() -> None:
    normal = stored(pupil_offset_err_mm=0.01, pupil_offset_interval_95_mm=None, k1_err=0.001)
    pupil, *_, k1 = geometry_verdicts(normal)
    # 1.96 times the standard error.
    assert pupil.remark == f"{normal.pupil_offset_mm:.3f} ± 0.020 mm"
    assert k1.remark.endswith(" ± 0.196 %")
    middle = normal.pupil_offset_mm
    # Student's with one degree of freedom: 12.7 times, for all that the heights give.
    few = normal.model_copy(
        update={
            "pupil_offset_interval_95_mm": (middle - 0.127, middle + 0.127),
            "scale_err_px_per_mm": (0.001,) * len(HEIGHTS),
        }
    )
    pupil, scale, *_, k1 = geometry_verdicts(few)
    assert pupil.remark.endswith(" ± 0.127 mm")
    assert scale.remark.endswith(" ± 0.0127 px/mm")
    assert k1.remark.endswith(" ± 0.196 %")


@pytest.mark.slow
def test_what_is_not_determined_is_said_and_not_drawn() -> None:
    bare = stored(
        k1=None, k2=None, tilt_deg=None, tilt_x_deg=None, tilt_y_deg=None, focal_length_px=None,
        scale_px_per_mm=None, undetermined={"tilt_deg": "no focal length"},
    )  # fmt: skip
    assert plot_distortion(bare) is None
    assert plot_squareness(bare) is None
    titles = [section.title for section in geometry_sections(bare)]
    assert "Distortion" not in titles
    values = {verdict.name: verdict.value for verdict in geometry_verdicts(bare)}
    assert values["tilt of target to sensor"] == "not determined"
    assert any("no focal length" in line for s in geometry_sections(bare) for line in s.text)


def test_a_file_with_the_contract_alone_makes_a_report() -> None:
    least = GeometryCalibration(
        heights_mm=HEIGHTS, scale_px_per_mm=None, pupil_offset_mm=3.0, k1=None, k2=None,
        tilt_deg=None, axis_drift_px_per_mm=None,
    )  # fmt: skip
    assert geometry_sections(least)
