"""Report sections on the geometry: headline figures, scales, zooms, distortion, squareness."""

from pathlib import PurePath

from analysis.reports.geometry_plots import (
    plot_distortion,
    plot_scale_by_height,
    plot_squareness,
    plot_travel,
)
from analysis.reports.page import ReportFigure, ReportSection, ReportTable, Verdict
from calibration.geometry import GeometryCalibration
from calibration.sharpness import NORMAL_95, with_reach

_SOURCES = {
    "board": "The scale is based on the size of the board's squares.",
    "given": "The scale is based on the value given for the lowest height.",
    "bench": "The scale is based on the focal length and pixel pitch in the bench file, taken as "
    "exact; with a varifocal lens it is only nominal.",
}


def geometry_verdicts(geometry: GeometryCalibration) -> tuple[Verdict, ...]:
    """Return the headline figures with their 95 % uncertainties."""
    factor, scales = geometry.fit_factor, geometry.scale_px_per_mm
    scale_errs = geometry.scale_err_px_per_mm
    known = (
        ("entrance pupil above height 0", geometry.pupil_offset_mm, 3, " mm"),
        (f"scale at {geometry.heights_mm[0]:g} mm", scales[0] if scales else None, 4, " px/mm"),
        ("tilt of target to sensor", geometry.tilt_deg, 3, "°"),
        ("distortion k1 at the corner", _in_percent(geometry.k1), 3, " %"),
    )
    reaches = (
        _times(factor, geometry.pupil_offset_err_mm),
        _times(factor, scale_errs[0] if scale_errs else None),
        _times(NORMAL_95, geometry.tilt_err_deg),
        _times(NORMAL_95, _in_percent(geometry.k1_err)),
    )
    return tuple(
        Verdict(
            name=name,
            value=_value(value, digits, unit),
            remark=""
            if value is None or reach is None
            else f"{with_reach(value, reach, digits)}{unit}",
        )
        for (name, value, digits, unit), reach in zip(known, reaches, strict=True)
    )


def geometry_sections(geometry: GeometryCalibration) -> tuple[ReportSection, ...]:
    """Return the sections on the geometry of camera and stage."""
    sections = [_scale_section(geometry), _squareness_section(geometry)]
    distortion = plot_distortion(geometry)
    if distortion is not None:
        sections.append(
            ReportSection(
                title="Distortion",
                text=(
                    "The ideal radius r, 1 at the image corner, is imaged at "
                    "r (1 + k1 r² + k2 r⁴). Negative values are barrel distortion.",
                ),
                tables=(_lens_table(geometry),),
                figures=(
                    ReportFigure.of(
                        distortion, "Radial displacement of a point from its ideal position."
                    ),
                ),
            )
        )
    sections.append(_captures_section(geometry))
    return tuple(sections)


def _scale_section(geometry: GeometryCalibration) -> ReportSection:
    lowest = geometry.heights_mm[0]
    zooms = {z.far_height_mm: z for z in geometry.zooms if z.near_height_mm == lowest}
    nothing = (None,) * len(geometry.heights_mm)
    scales = nothing if geometry.scale_px_per_mm is None else geometry.scale_px_per_mm
    errs = nothing if geometry.scale_err_px_per_mm is None else geometry.scale_err_px_per_mm
    rows = tuple(
        (
            f"{height:g}",
            _value(scale, 5, ""),
            "" if err is None else f"{geometry.fit_factor * err:.5f}",
            f"{zooms[height].zoom:.5f}" if height in zooms else "1",
            f"{geometry.fit_factor * zooms[height].zoom_err:.5f}" if height in zooms else "",
        )
        for height, scale, err in zip(geometry.heights_mm, scales, errs, strict=True)
    )
    source = geometry.scale_source
    text = [
        "Pinhole model at the entrance pupil: the scale is the focal length in pixels over the "
        "distance, which is the height plus the pupil's offset.",
        _SOURCES[source] if source else "No length is known, so there is no absolute scale.",
    ]
    text += [f"{name} is not determined: {why}." for name, why in geometry.undetermined.items()]
    return ReportSection(
        title="Scale and zoom",
        text=(*text, *geometry.notes),
        tables=(
            ReportTable(
                columns=(
                    "height / mm",
                    "scale / (px/mm)",
                    "± px/mm",
                    f"zoom from {lowest:g} mm",
                    "± zoom",
                ),
                rows=rows,
            ),
        ),
        figures=(
            ReportFigure.of(
                plot_scale_by_height(geometry),
                "Scale of every capture, and the height read back minus the one fitted to its "
                "image, with the 95 % interval of the fit.",
            ),
        ),
    )


def _squareness_section(geometry: GeometryCalibration) -> ReportSection:
    figures = []
    squareness = plot_squareness(geometry)
    if squareness is not None:
        figures.append(
            ReportFigure.of(
                squareness,
                "Direction in which the optical axis leans, as seen in the image; the cross is "
                "the 95 % interval, the centre is square.",
            )
        )
    travel = plot_travel(geometry)
    if travel is not None:
        figures.append(
            ReportFigure.of(travel, "Sideways deviation of the camera from straight travel.")
        )
    rows = [
        ("tilt of target to sensor / deg", geometry.tilt_deg, geometry.tilt_err_deg, 4),
        (
            f"drift of the axis at {geometry.heights_mm[0]:g} mm / (px/mm)",
            geometry.axis_drift_px_per_mm,
            geometry.axis_drift_err_px_per_mm,
            5,
        ),
        (
            "stage travel to line of sight / deg",
            geometry.stage_angle_deg,
            geometry.stage_angle_err_deg,
            4,
        ),
    ]
    return ReportSection(
        title="Squareness",
        tables=(
            ReportTable(
                columns=("", "value", "±"),
                rows=tuple(
                    (
                        name,
                        _value(value, digits, ""),
                        "" if err is None else f"{NORMAL_95 * err:.{digits}f}",
                    )
                    for name, value, err, digits in rows
                ),
            ),
        ),
        figures=tuple(figures),
    )


def _lens_table(geometry: GeometryCalibration) -> ReportTable:
    rows = [
        ("k1, at the image corner", geometry.k1, geometry.k1_err),
        ("k2, at the image corner", geometry.k2, geometry.k2_err),
        ("k1 of OpenCV", geometry.k1_opencv, None),
        ("k2 of OpenCV", geometry.k2_opencv, None),
    ]
    return ReportTable(
        columns=("", "value", "±"),
        rows=tuple(
            (name, _value(value, 5, ""), "" if err is None else f"{NORMAL_95 * err:.5f}")
            for name, value, err in rows
        ),
    )


def _captures_section(geometry: GeometryCalibration) -> ReportSection:
    used = tuple(
        (
            PurePath(capture.image).name,
            f"{capture.height_mm:.3f}",
            _value(capture.scale_px_per_mm, 5, ""),
            f"{1e3 * capture.height_residual_mm:.1f}",
            str(capture.matches),
            f"{capture.rms_px:.4f}",
            "",
        )
        for capture in geometry.captures
    )
    left_out = tuple(
        (PurePath(item.image).name, "", "", "", "", "", f"excluded: {item.reason}")
        for item in geometry.excluded
    )
    return ReportSection(
        title="Captures",
        is_folded=True,
        tables=(
            ReportTable(
                columns=(
                    "image",
                    "height / mm",
                    "scale / (px/mm)",
                    "height residual / µm",
                    "matches",
                    "rms / px",
                    "remarks",
                ),
                rows=(*used, *left_out),
            ),
        ),
    )


def _value(value: float | None, digits: int, unit: str) -> str:
    return "not determined" if value is None else f"{value:.{digits}f}{unit}"


def _times(factor: float, err: float | None) -> float | None:
    return None if err is None else factor * err


def _in_percent(share: float | None) -> float | None:
    return None if share is None else 100 * share
