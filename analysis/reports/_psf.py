"""Report sections on a PSF: the first page, headline figures, edges, profiles, widths, MTF."""

from collections.abc import Callable, Iterable
from itertools import groupby

from analysis.reports._page import (
    ReportFigure,
    ReportFront,
    ReportSection,
    ReportTable,
    Verdict,
    encodings_text,
    moment_text,
    number_text,
    present,
)
from analysis.reports._psf_edges import curves_section, plot_edges, plot_profile
from analysis.reports._psf_field import (
    field_map_section,
    field_section,
    lateral_colour_section,
    plot_mtf,
    plot_transfer_2d,
    widths_section,
    with_err,
)
from calibration.edges import REJECTING_FLAGS, EdgeMeasurement
from calibration.estimate import NORMAL_95, with_reach
from calibration.psf import PsfCalibration, Transfer2d
from calibration.sharpness import (
    VERDICT_COLUMNS,
    SharpnessVerdict,
    edge_cells,
    lp_per_mm,
    lw_per_ph,
    median_of_edges,
    reported_mtf50,
    verdict_rows,
)
from simulation.arrays import FloatImage

_ImageLoader = Callable[[EdgeMeasurement], FloatImage]

_IMAGES_SHOWN = 4
_EDGES_WITH_CURVES_FIRST = 5  # they fill a page; those of more edges come last
_WHOLE_WIDTH_IN, _HALF_WIDTH_IN = 7.2, 3.6
_DIRECTION_STEP_DEG = 15.0


def calibration_verdicts(psf: PsfCalibration) -> tuple[Verdict, ...]:
    """Return the headline figures with their 95 % uncertainties: MTF50, widths, correlation.

    What the edges do not determine is left out.
    """
    used, found = len(psf.edges_used), len(psf.edges)
    return (
        *_mtf50_verdicts(psf),
        *(
            Verdict(name, f"{value:.4f}{unit}", f"95 %: {interval}" if interval else "")
            for name, key, unit in (
                ("total sigma x", "sigma_x_px", " px"),
                ("total sigma y", "sigma_y_px", " px"),
                ("correlation rho", "rho", ""),
            )
            for value, interval in [_value_and_interval(psf, key)]
            if value is not None
        ),
        Verdict("edges used", str(used), f"of {found} found"),
    )


def _mtf50_verdicts(psf: PsfCalibration) -> list[Verdict]:
    """MTF50 of the only edge, or the median of many and the softest."""
    ranked = sorted(psf.edges_used, key=lambda edge: reported_mtf50(edge).cy_per_px)
    height, pitch_um = psf.picture_height_px, psf.pixel_pitch_um
    if len(ranked) < 2:
        return [_mtf50_verdict("MTF50", edge, pitch_um) for edge in ranked]
    middle = median_of_edges(ranked)
    units = [(1.0, 4, "cy/px")]
    units += [] if height is None else [(lw_per_ph(1.0, height), 1, "LW/PH")]
    units += [] if pitch_um is None else [(lp_per_mm(1.0, pitch_um), 2, "lp/mm")]
    said = "; ".join(
        f"{with_reach(factor * middle.value, factor * NORMAL_95 * middle.err, digits)} {unit}"
        for factor, digits, unit in units
    )
    return [
        Verdict(f"MTF50, median of {len(ranked)} edges", f"{middle.value:.3f} cy/px", said),
        _mtf50_verdict("MTF50, softest edge", ranked[0], pitch_um),
        _mtf50_verdict("MTF50, sharpest edge", ranked[-1], pitch_um),
    ]


def _mtf50_verdict(name: str, edge: EdgeMeasurement, pixel_pitch_um: float | None) -> Verdict:
    known = reported_mtf50(edge)
    _, [cells] = edge_cells([edge], pixel_pitch_um, has_image=False)
    units = ("cy/px", "LW/PH", "lp/mm")[: 2 + (pixel_pitch_um is not None)]
    said = "; ".join(
        f"{cell.removesuffix(' *')} {unit}"
        for cell, unit in zip(cells[1:], units, strict=False)
        if cell
    )
    model = "" if known.is_model_free else ", of the fitted Gaussian"
    return Verdict(name, f"{known.cy_per_px:.3f} cy/px", f"{said}{model}")


def calibration_sections(
    psf: PsfCalibration, load_image: _ImageLoader, images: frozenset[str] | None = None
) -> tuple[ReportSection, ...]:
    """Return the sections on a PSF, except the list of edges.

    ``load_image``: gives the linear image that an edge was measured on, shape ``(rows, cols)``.
    ``images``: names of the photographs that are at hand, None for all. Edges of others are in the
    widths and tables, but cannot be drawn; the report says so.
    """
    drawn = [edge for edge in psf.edges if images is None or edge.image in images]
    curves = curves_section(psf)
    is_short = len(psf.edges_used) <= _EDGES_WITH_CURVES_FIRST
    return present(
        edges_section(psf, drawn, load_image) if psf.edges else None,
        curves if is_short else None,
        field_map_section(psf),
        lateral_colour_section(psf),
        _psf_section(psf),
        _profiles_section(drawn, load_image) if drawn else None,
        widths_section(psf),
        field_section(psf),
        None if is_short else curves,
    )


def _missing_text(missing: int) -> str | None:
    if missing == 0:
        return None
    return (
        f"{missing} edges of this psf.json are on photographs that are not available here: they "
        "count in the widths and are listed in the tables, but are not drawn."
    )


def _psf_section(psf: PsfCalibration) -> ReportSection:
    parameters = (("sigma x", "sigma_x_px"), ("sigma y", "sigma_y_px"), ("rho", "rho"))
    missing = [name for name, key in parameters if getattr(psf, key) is None]
    rows = tuple(
        (
            f"{name} / px" if key != "rho" else name,
            *_cells(*_value_and_interval(psf, key)),
            *_cells(*_value_and_interval(psf, f"optical_{key}")),
        )
        for name, key in parameters
        if name not in missing
    )
    columns = ("", "total", "95 % interval", "optical", "95 % interval")
    transfer = psf.transfer_2d
    return ReportSection.of(
        "Point spread function",
        "Total is what the image shows: optics and square pixel together, the Sigma of the "
        "capture model. Optical is the lens alone.",
        *_origin(psf),
        f"Not determined by these edges: {', '.join(missing)}." if missing else None,
        ReportTable(columns=columns, rows=rows),
        _channels_table(psf),
        ReportFigure.if_drawn(
            plot_mtf(psf),
            "Contrast at each frequency, optics and pixel together. The e-SFR is measured "
            "without a model (median over edges); where it departs from the Gaussian curve, "
            "the PSF is not Gaussian.",
        ),
        ReportFigure.if_drawn(
            None if transfer is None else plot_transfer_2d(transfer),
            _of_transfer(transfer),
        ),
    )


def _of_transfer(transfer: Transfer2d | None) -> str:
    if transfer is None:
        return ""
    told = "no pixel tells that frequency" if transfer.pairs else "no edge tells that direction"
    return (
        "Transfer function of optics and pixel, fitted to the pixels of "
        f"{transfer.measured_on} at once, with its pointwise 95 % band: {transfer}. Below 0, light "
        f"and dark are exchanged. Where a band leaves the figure, {told}."
    )


def _cells(value: float | None, interval: str) -> tuple[str, str]:
    return number_text(value, ".4f", "not determined"), interval


def _origin(psf: PsfCalibration) -> tuple[str, ...]:
    return present(
        "Method paper: medians of Gaussians fitted to binned line spread functions. It is "
        "biased by +5 % at 0.5 px and +1.3 % at 1 px, and gives no optical width and no rho."
        if psf.method == "paper"
        else None,
        None if psf.region is None else f"Only the region {psf.region} of the frame was used.",
        None if psf.channel is None else f"Colour: {psf.channel}.",
    )


def _channels_table(psf: PsfCalibration) -> ReportTable | None:
    if not psf.channels:
        return None
    return ReportTable.of(
        psf.channels.items(),
        {
            "colour": lambda row: row[0],
            "total sigma x / px": lambda row: with_err(row[1].sigma_x_px, row[1].sigma_x_err_px),
            "total sigma y / px": lambda row: with_err(row[1].sigma_y_px, row[1].sigma_y_err_px),
            "optical sigma x / px": lambda row: with_err(
                row[1].optical_sigma_x_px, row[1].optical_sigma_x_err_px
            ),
            "optical sigma y / px": lambda row: with_err(
                row[1].optical_sigma_y_px, row[1].optical_sigma_y_err_px
            ),
        },
        "Widths by colour of the mosaic.",
    )


def edges_section(
    psf: PsfCalibration,
    found: list[EdgeMeasurement],
    load_image: _ImageLoader,
    most: int = _IMAGES_SHOWN,
    half_width_in: float = _HALF_WIDTH_IN,
) -> ReportSection:
    """Show the edges on up to so many photographs, two side by side."""
    missing = _missing_text(len(psf.edges) - len(found))
    if not found:
        return ReportSection.of("Edges", missing)
    by_image = {
        name: list(edges)
        for name, edges in groupby(sorted(found, key=lambda e: e.image), lambda e: e.image)
    }
    # Photographs whose edges point in other directions than those already shown.
    by_direction = {_directions(edges): name for name, edges in reversed(by_image.items())}
    shown = sorted(by_direction.values())[:most]
    width_in = _WHOLE_WIDTH_IN if len(shown) == 1 else half_width_in
    text = "The edge that was found and fitted, with its MTF50 in cy/px."
    if len(found) > 1:
        text = (
            "Every straight edge that was found and fitted, with its MTF50 in cy/px; long ones are "
            "cut into pieces. Labels that would overlap are left out, except those of the softest "
            "and the sharpest edge."
        )
    is_cut = len(by_image) > len(shown)
    return ReportSection.of(
        "Edges",
        text,
        f"{len(shown)} of {len(by_image)} photographs are shown." if is_cut else None,
        missing,
        *(
            ReportFigure.of(
                plot_edges(load_image(edges[0]), edges, REJECTING_FLAGS, width_in),
                f"Edges of {name} and their MTF50 in cy/px.",
                form="png",
            )
            for name in shown
            for edges in [by_image[name]]
        ),
    )


def _directions(edges: list[EdgeMeasurement]) -> frozenset[int]:
    return frozenset(round(edge.angle_deg / _DIRECTION_STEP_DEG) for edge in edges)


def _profiles_section(found: list[EdgeMeasurement], load_image: _ImageLoader) -> ReportSection:
    figures = []
    for orientation in ("vertical", "horizontal", "diagonal"):
        edges = [
            edge
            for edge in found
            if edge.orientation == orientation and not REJECTING_FLAGS & set(edge.flags)
        ]
        if not edges:
            continue
        # The edge in the middle of the ranking: neither the best nor the worst.
        typical = sorted(edges, key=lambda edge: edge.sigma_px)[len(edges) // 2]
        caption = (
            f"A typical {orientation} edge: {typical.angle_deg:.1f} degrees, "
            f"{typical.length_px:.0f} px long, at ({typical.x_px:.0f}, {typical.y_px:.0f})."
        )
        figures.append(ReportFigure.of(plot_profile(load_image(typical), typical), caption))
    return ReportSection.of(
        "Edge profiles",
        "Raw pixels by distance from the edge, the fitted edge, and the residuals. Residuals "
        "that oscillate about zero at the edge mean that the PSF is not Gaussian.",
        *figures,
    )


def _value_and_interval(psf: PsfCalibration, key: str) -> tuple[float | None, str]:
    """A parameter and its 95 % interval in words, which is empty where it is not known."""
    value: float | None = getattr(psf, key)
    if value is None or key not in psf.intervals_95:
        return value, ""
    low, high = psf.intervals_95[key]
    return value, f"{low:.4f} to {high:.4f}"


_UNSTATED = "not stated"
_NAMED_BY_PEOPLE = ("customer", "operator", "target")
_NAMED_BY_FILES = ("camera", "lens")
"""What people say comes before what files say."""
_FACTS = (
    ("camera", "camera"),
    ("lens", "lens"),
    ("focal_length_mm", "focal length"),
    ("f_number", "f-number"),
    ("exposure_s", "exposure"),
    ("iso", "ISO"),
)


def calibration_front(psf: PsfCalibration, warnings: Iterable[str]) -> ReportFront:
    """Return the verdict, the facts about the photographs, and the command's warnings."""
    return ReportFront(
        outcome="none" if psf.verdict is None else psf.verdict.outcome,
        verdict=_sentence(psf.verdict),
        facts=tuple(_facts(psf)),
        warnings=tuple(warnings),
    )


def _sentence(verdict: SharpnessVerdict | None) -> str:
    if verdict is None:
        return ""
    total = len(verdict.limits)
    counts = {
        name: sum(one.outcome == name for one in verdict.limits)
        for name in ("pass", "fail", "unsure")
    }
    words = {"pass": "passed", "fail": "failed", "unsure": "unsure"}
    said = ", ".join(f"{count} {words[name]}" for name, count in counts.items() if count)
    return f"{total} limit{'s' * (total != 1)} of {verdict.limits_file}: {said}."


def _facts(psf: PsfCalibration) -> Iterable[tuple[str, str]]:
    stated = dict(psf.photograph or {})
    if psf.camera is not None and psf.camera.model and "camera" not in stated:
        names = (psf.camera.vendor, psf.camera.model, psf.camera.serial)
        stated["camera"] = " ".join(name for name in names if name)
    labels = psf.labels or {}
    stated.update({name: text for name, text in labels.items() if name in _NAMED_BY_FILES})
    for name in _NAMED_BY_PEOPLE:
        if name in labels:
            yield name, labels[name]
    taken = psf.captured_utc or stated.get("taken")
    yield "photographed", _UNSTATED if taken is None else moment_text(str(taken))
    yield "measured", _UNSTATED if psf.provenance is None else moment_text(psf.provenance.created)
    for key, label in _FACTS:
        yield label, _text(key, stated.get(key))
    yield "encoding", encodings_text(psf.provenance) or _UNSTATED
    width, height = psf.picture_width_px, psf.picture_height_px
    yield "picture", _UNSTATED if width is None else f"{width} x {height} px"
    pitch = psf.pixel_pitch_um
    yield ("pixel pitch", "unknown" if pitch is None else f"{pitch:g} µm ({psf.pixel_pitch_from})")


def _text(key: str, value: str | float | None) -> str:
    if value is None or value == "":
        return _UNSTATED
    if isinstance(value, str):
        return value
    if key == "exposure_s":
        return f"1/{1 / value:.0f} s" if 0 < value < 0.3 else f"{value:g} s"
    return {"focal_length_mm": f"{value:g} mm", "f_number": f"f/{value:g}"}.get(key, f"{value:g}")


def verdict_section(psf: PsfCalibration) -> ReportSection | None:
    """Tabulate every limit with its figure; None without limits."""
    if psf.verdict is None:
        return None
    return ReportSection.of(
        "Limits",
        "A limit is passed where the whole interval keeps it, failed where none of it does, "
        "and unsure where the interval straddles it. Over several edges or corners the "
        "intervals are widened so that they hold all together (Bonferroni).",
        ReportTable(columns=VERDICT_COLUMNS, rows=verdict_rows(psf.verdict), ends_in_words=True),
    )
