"""The report of a lens and its camera: six figures at most, maps of the field, then details."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from acquisition.session import Session
from analysis.reports._bench import device_rows, versions
from analysis.reports._lens_focus import focus_section
from analysis.reports._noise import camera_section
from analysis.reports._page import (
    Report,
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    in_report_style,
    new_figure,
    new_plot,
    present,
)
from analysis.reports._psf import calibration_front, edges_section, verdict_section
from analysis.reports._psf_field import field_map_section, lateral_colour_section
from calibration.edges import EdgeMeasurement
from calibration.estimate import NORMAL_95, with_reach
from calibration.lens import (
    CapacityFigures,
    LensMeasurement,
    StarFigures,
    TextureFigures,
    frequency_units,
)
from calibration.robust import median_err
from calibration.sharpness import (
    EdgeFigures,
    MeasuredValue,
    edge_name,
    reported_mtf50,
)
from simulation.palette import BLUE, GREEN, INK, POINTS, VERMILION

_INKS = {"grey": INK, "luma": INK, "red": VERMILION, "green": GREEN, "blue": BLUE}
_NAMES = {"luma": "Y", "red": "R", "green": "G", "blue": "B", "grey": "grey"}
_EDGES_LISTED = 6
_INPUTS_LISTED = 4
_PHOTOGRAPH_IN = 2.3
_PROFILE_PX = 6.0
_DIGITS = {"cy/px": 4, "LW/PH": 0, "lp/mm": 2, "px": 3, "%": 2, "": 4}

_DEPARTURES = (
    "ISO 12233:2024, e-SFR. As in the standard: slanted straight edges, linear levels, the "
    "contrast at each frequency across the edge from the derivative of its profile, 1 at frequency "
    "0; MTF of lens and pixel together; over- and undershoot of the edge profile.",
    "Departures: edges at any angle, found by the program; pixels are not binned by quarters of a "
    "pixel but fitted by a Gaussian, a tail and a penalised spline, so that neither bins nor the "
    "window nor the difference blurs the curve, and no correction for them is applied; the edge "
    "may be slightly curved. The contrast of the target is not checked against the standard's 4:1.",
    "EMVA 1288 release 4, linear model: gain, read noise, saturation, linearity, dark signal and "
    "nonuniformity. Without a calibrated light source there is no quantum efficiency and no "
    "irradiance; figures are in electrons and DN.",
    "Noise-equivalent quanta: ICRU Report 54. Information by edges: Koren, Electronic Imaging, "
    "2020 to 2024.",
)


_OF_STARS = (
    "ISO 12233:2024, s-SFR: as in the standard a wave fitted in eight sectors of a star. "
    "Departures: the centre is found by the program; the part in phase with the star counts, not "
    "the modulus; contrast is scaled by edges, or extrapolated, not by patches of the chart."
)
_OF_TEXTURE = (
    "ISO 19567-2, dead leaves: as in the standard, contrast of texture by frequency from spectra "
    "of a stochastic target. Departures: the target is known by its picture, and found by "
    "registration; both the direct method and the intrinsic one; contrast 1 is extrapolated."
)
_OF_FOCUS = (
    "Focus: the position of the largest contrast at one frequency; ISO 12233 and EMVA 1288 have no "
    "such figures. Third-order field curvature and astigmatism, and a flat target across the axis."
)


def lens_report(
    lens: LensMeasurement,
    load: Callable[[str], NDArray[np.floating[Any]]],
    session: Session | None = None,
) -> Report:
    """Return the report of a lens and its camera.

    ``load``: returns a photograph by its name, shape ``(rows, cols)``, linear in light.
    ``session``: where the photographs are from, for the names of its devices.
    """
    psf = lens.psf
    names = list(dict.fromkeys(edge.image for edge in psf.edges))
    subtitle = names[0] if len(names) == 1 else f"{len(names)} photographs of edges"
    front = calibration_front(psf, lens.notes)
    software = ("software", f"standoff {_own_version()}")
    facts = (*front.facts, *_standards(lens), software)
    return Report(
        title="Lens and camera",
        subtitle=subtitle,
        verdicts=tuple(_headlines(lens)),
        sections=present(
            verdict_section(psf),
            _sharpness_section(lens),
            field_map_section(psf),
            lateral_colour_section(psf),
            _stars_section(lens),
            _texture_section(lens),
            focus_section(lens),
            _information_section(lens.capacity),
            None if lens.noise_measurement is None else camera_section(lens.noise_measurement),
            _photographs_section(lens, load),
            _edges_section(lens),
            ReportSection.of(
                "Standards and departures",
                *_DEPARTURES,
                _OF_STARS if lens.stars else None,
                _OF_TEXTURE if lens.textures else None,
                _OF_FOCUS if lens.through_focus is not None else None,
                is_folded=True,
            ),
        ),
        provenance=(*(() if session is None else device_rows(session)), *versions()),
        origin=lens.provenance,
        front=replace(front, facts=facts),
        inputs_listed=_INPUTS_LISTED,
    )


def _standards(lens: LensMeasurement) -> Iterator[tuple[str, str]]:
    """Name the standards by which something on the page was measured."""
    named = []
    if any(edge.figures.is_model_free for edge in lens.edges):
        named.append("ISO 12233:2024 (e-SFR, annex D)")
    if lens.stars:
        named.append("ISO 12233:2024 (s-SFR)")
    if lens.textures:
        named.append("ISO 19567-2 (dead leaves)")
    if lens.noise_measurement is not None:
        named.append("EMVA 1288 R4 (linear)")
    if named:
        yield "standards", ", ".join(named)


def _own_version() -> str:
    return dict(versions())["standoff"]


def _headlines(lens: LensMeasurement) -> Iterator[Verdict]:
    """Up to six figures: of the lens, of its processing, of the camera, of both together."""
    main = lens.main
    half = main.median.mtf50_cy_per_px
    if half is not None:
        units = list(frequency_units(lens))
        said = "; ".join(_with_unit(half, factor, unit) for unit, factor in units)
        yield Verdict(f"MTF50, median of {main.edges} edges", f"{half.value:.3f} cy/px", said)
    yield from _softest(lens)
    quarter = main.median.mtf_at_half_nyquist
    if quarter is not None:
        yield Verdict(
            "contrast at half Nyquist",
            f"{quarter.value:.3f}",
            _with_unit(quarter, 1.0, ""),
        )
    if lens.lateral_fields:
        field = max(lens.lateral_fields, key=lambda one: one.worst_px.value)
        yield Verdict(
            "largest lateral chromatic aberration",
            f"{field.worst_px.value:.3f} px",
            f"{field.colour}: {_with_unit(field.worst_px, 1.0, 'px')} over the field",
        )
    elif lens.lateral_colour:
        most = max(lens.lateral_colour, key=lambda one: abs(one.shift_px.value))
        yield Verdict(
            "largest lateral chromatic aberration",
            f"{abs(most.shift_px.value):.3f} px",
            f"{most.colour}: {_with_unit(most.shift_px, 1.0, 'px')}",
        )
    elif lens.sharpening is not None:
        over = lens.sharpening.overshoot
        said = "sharpened" if lens.sharpening.is_sharpened else "no sign of sharpening"
        yield Verdict(
            "overshoot", f"{100 * over.value:.1f} %",
            f"{_with_unit(over, 100.0, '%')}; {said}",
        )  # fmt: skip
    if lens.capacity is not None:
        yield Verdict(
            "information",
            f"{lens.capacity.bits_per_px.value:.2f} bits/px",
            f"{lens.capacity.bits_per_px.estimate.text(2)}; between the levels of the edges, "
            f"{lens.capacity.range_dn:.0f} DN apart",
        )
    yield from _last_headline(lens)


def _softest(lens: LensMeasurement) -> Iterator[Verdict]:
    ranked = sorted(lens.psf.edges_used, key=lambda edge: reported_mtf50(edge).cy_per_px)
    if len(ranked) < 2:
        return
    edge = ranked[0]
    known = reported_mtf50(edge)
    yield Verdict(
        "MTF50, softest edge",
        f"{known.cy_per_px:.3f} cy/px",
        f"{with_reach(known.cy_per_px, known.reach_95_cy_per_px, 4)} at "
        f"({edge.x_px:.0f}, {edge.y_px:.0f})",
    )


def _last_headline(lens: LensMeasurement) -> Iterator[Verdict]:
    """The camera's dynamic range; without darks and flats, the contrast that is just seen."""
    if lens.noise_measurement is not None:
        sheet = lens.noise_measurement.emva
        yield Verdict(
            "dynamic range",
            f"{sheet.dynamic_range_db:.1f} dB",
            f"{sheet.dynamic_range_text}; {sheet.dynamic_range_bits:.1f} bits; EMVA 1288",
        )
    elif lens.capacity is not None:
        disc = lens.capacity.detection[1]
        yield Verdict(
            f"contrast just seen, {disc.description}",
            f"{100 * disc.threshold_contrast:.2f} %",
            "by an ideal observer, SNR 5",
        )


def _with_unit(known: MeasuredValue, factor: float, unit: str) -> str:
    return f"{_cell(known, factor, unit)} {unit}".rstrip()


_ROWS: Final = (
    ("MTF50", "mtf50_cy_per_px"),
    ("MTF50P", "mtf50p_cy_per_px"),
    ("MTF20", "mtf20_cy_per_px"),
    ("MTF10", "mtf10_cy_per_px"),
    ("contrast at half Nyquist", "mtf_at_half_nyquist"),
    ("contrast at Nyquist", "mtf_at_nyquist"),
    ("edge rise, 10 to 90 %", "rise_px"),
    ("overshoot", "overshoot"),
    ("undershoot", "undershoot"),
)


def _sharpness_section(lens: LensMeasurement) -> ReportSection:
    counts = ", ".join(f"{_NAMES[one.colour]} {one.edges}" for one in lens.colours)
    height = lens.picture_height_px
    sentence = None if lens.sharpening is None else lens.sharpening.sentence
    return ReportSection.of(
        "Sharpness",
        f"Medians over the edges ({counts}), of lens, pixel and processing together. MTF50 and so "
        "on: where so much of the contrast at frequency 0 is left; MTF50P: half of the largest "
        "contrast, which sharpening raises less. Over- and undershoot: of the median edge profile "
        "beyond its flat ends, over their difference.",
        None if height is None else f"Picture height (PH): {height} px.",
        _OF_MOSAICS if lens.psf.channels else None,
        *_by_gaussian(lens),
        sentence,
        _sharpness_table(lens),
        ReportFigure.of(
            _plot_sfr(lens),
            "Contrast by frequency, median over the edges, with 95 % bands. Dotted: Nyquist and "
            "half of it.",
        )
        if any(one.sfr for one in lens.colours)
        else None,
        ReportFigure.if_drawn(
            _plot_edge_profile(lens.psf.edges_used),
            "Edge profile, median over the edges, 0 and 1 its flat ends, with its 95 % band.",
        ),
    )


_OF_MOSAICS: Final = (
    "Raw mosaics: frequencies are in cycles per pixel of the sensor, as is Nyquist, 0.5 cy/px. A "
    "colour has every second pixel: its own Nyquist frequency is 0.25 cy/px, and contrast beyond "
    "that comes back as aliasing before the colours are interpolated."
)


def _by_gaussian(lens: LensMeasurement) -> Iterator[str]:
    count = sum(
        not edge.figures.is_model_free for edge in lens.edges if edge.colour == lens.main.colour
    )
    if count:
        yield (
            f"{count} of {lens.main.edges} edges do not determine an e-SFR with an error (too "
            "short, or along the rows or columns of the pixels): the fitted Gaussian stands in."
        )


def _sharpness_table(lens: LensMeasurement) -> ReportTable:
    """Return a row for each figure: in every colour, and of the first also in the other units."""
    others = [(unit, factor) for unit, factor in frequency_units(lens) if unit != "cy/px"]
    of_main = f" ({_NAMES[lens.main.colour]})" if len(lens.colours) > 1 else ""
    rows = []
    for label, name in _ROWS:
        values = [getattr(one.median, name) for one in lens.colours]
        if all(value is None for value in values):
            continue
        unit, factor = _unit_of(name)
        cells = ["" if one is None else _cell(one, factor, unit) for one in values]
        first = values[0] if name.endswith("_cy_per_px") else None
        cells += ["" if first is None else _cell(first, more, other) for other, more in others]
        rows.append((label, unit, *cells))
    return ReportTable(
        columns=(
            *("", "unit"),
            *(_NAMES[one.colour] for one in lens.colours),
            *(f"{unit}{of_main}" for unit, _ in others),
        ),
        rows=tuple(rows),
    )


def _unit_of(name: str) -> tuple[str, float]:
    """Unit of a figure on the page, and what the stored value is multiplied by."""
    if name in ("overshoot", "undershoot"):
        return "%", 100.0
    if name.endswith("_cy_per_px"):
        return "cy/px", 1.0
    return ("px", 1.0) if name.endswith("_px") else ("", 1.0)


def _cell(known: MeasuredValue, factor: float, unit: str) -> str:
    return with_reach(factor * known.value, NORMAL_95 * factor * known.err, _DIGITS[unit])


@in_report_style
def _plot_sfr(lens: LensMeasurement) -> Figure:
    """Plot the median contrast by frequency of every colour, with its 95 % band."""
    figure, axes = new_plot(3.6, 2.6)
    for one in lens.colours:
        if one.sfr is None:
            continue
        freq, mtf = np.array(one.sfr.freq_cy_per_px), np.array(one.sfr.mtf)
        ink = _INKS[one.colour]
        axes.plot(freq, mtf, color=ink, linewidth=1.4, label=_NAMES[one.colour])
        if one.sfr.mtf_err is not None:
            reach = NORMAL_95 * np.array(one.sfr.mtf_err)
            axes.fill_between(freq, mtf - reach, mtf + reach, color=ink, alpha=0.15, linewidth=0)
    for marked in (0.25, 0.5):
        axes.axvline(marked, color=POINTS, linewidth=0.8, linestyle=":")
    axes.set(xlabel="frequency / (cy/px)", ylabel="contrast", xlim=(0, 1), ylim=(0, None))
    if len(lens.colours) > 1:
        axes.legend()
    return figure


@in_report_style
def _plot_edge_profile(edges: Iterable[EdgeMeasurement]) -> Figure | None:
    """Plot the median edge profile; None without an e-SFR."""
    known = [edge.esfr for edge in edges if edge.esfr is not None]
    if not known:
        return None
    reach = min(_PROFILE_PX, *(one.reach_px for one in known))
    distance = np.linspace(-reach, reach, 241)
    profiles = np.array([one.esf(distance) for one in known])
    errs = np.array([one.esf_err(distance) for one in known])
    middle = np.median(profiles, axis=0)
    band = NORMAL_95 * median_err(profiles, errs)
    figure, axes = new_plot(3.6, 2.6)
    axes.plot(distance, middle, color=INK, linewidth=1.4)
    axes.fill_between(distance, middle - band, middle + band, color=INK, alpha=0.15, linewidth=0)
    for level in (0.0, 1.0):
        axes.axhline(level, color=POINTS, linewidth=0.8, linestyle=":")
    axes.set(xlabel="distance across the edge / px", ylabel="level", xlim=(-reach, reach))
    return figure


def _stars_section(lens: LensMeasurement) -> ReportSection | None:
    """Stars beside the edges of the same photographs; None without any."""
    if not lens.stars:
        return None
    first = lens.stars[0]
    by = {"edges": "by the edges of the photograph", "extrapolation": "extrapolated"}
    return ReportSection.of(
        "Siemens stars",
        "Contrast of a wave around the centre of the star, in eight sectors (ISO 12233, s-SFR), as "
        "far as half a cycle a pixel. Contrast 1 is that at frequency 0: "
        f"{', '.join(dict.fromkeys(by[star.scaled_by] for star in lens.stars))}.",
        ReportTable.of(
            lens.stars,
            {
                "star": lambda one: f"({one.x_px:.1f}, {one.y_px:.1f}), {one.cycles} cycles",
                "MTF50 / (cy/px)": lambda one: _text(one.figures.mtf50_cy_per_px),
                "MTF20 / (cy/px)": lambda one: _text(one.figures.mtf20_cy_per_px),
                "MTF10 / (cy/px)": lambda one: _text(one.figures.mtf10_cy_per_px),
                "MTF50 over that of the edges": lambda one: _text(one.mtf50_over_edges),
            },
        ),
        ReportFigure.of(_plot_star(first), "Contrast by frequency of the first star, 95 % bars."),
        ReportFigure.of(
            _plot_sectors(first),
            "MTF50 of its sectors, at their directions from its centre (y down), with 95 % bars: "
            "of the contrast across that direction.",
        ),
    )


def _text(known: MeasuredValue | None) -> str:
    return "" if known is None else known.estimate.text(4)


@in_report_style
def _plot_star(star: StarFigures) -> Figure:
    """Plot the contrast of a star, mean over its sectors."""
    figure, axes = new_plot(3.6, 2.6)
    axes.errorbar(
        star.freq_cy_per_px,
        star.mtf,
        yerr=NORMAL_95 * np.array(star.mtf_err),
        fmt=".",
        markersize=3,
        linewidth=0.8,
        color=INK,
    )
    axes.set(xlabel="frequency / (cy/px)", ylabel="contrast", xlim=(0, 0.5), ylim=(0, None))
    return figure


@in_report_style
def _plot_sectors(star: StarFigures) -> Figure:
    """Map the MTF50 of the sectors of a star by direction."""
    figure = new_figure(2.8, 2.8)
    axes: Any = figure.add_subplot(projection="polar")
    known = [
        (one.direction_deg, half.value, NORMAL_95 * half.err)
        for one in star.sectors
        if (half := one.figures.mtf50_cy_per_px) is not None
    ]
    if known:
        turn, half_of, reach = np.array(known).T
        axes.errorbar(
            np.deg2rad(turn), half_of, yerr=reach, fmt="o", markersize=4, linewidth=1.0, color=BLUE
        )
        axes.set(ylim=(0, 1.15 * float(np.max(half_of))))
    axes.set_theta_direction(-1)
    axes.set_rlabel_position(0.0)  # between two sectors, whose middles are at 22.5 degrees and on
    axes.yaxis.set_major_locator(MaxNLocator(3))
    return figure


def _texture_section(lens: LensMeasurement) -> ReportSection | None:
    """Dead leaves beside edges; None without any."""
    if not lens.textures:
        return None
    first = lens.textures[0]
    return ReportSection.of(
        "Texture (dead leaves)",
        "Intrinsic (Kirk et al.): the detail of the target that the photograph still shows. Direct "
        "(McElvain et al.): all its detail, also what processing adds, less the noise beside the "
        "edges. Contrast 1 is extrapolated from the lowest frequencies.",
        *dict.fromkeys(one.sentence for one in lens.textures),
        ReportTable.of(
            lens.textures,
            {
                "target": lambda one: f"({one.x_px:.0f}, {one.y_px:.0f})",
                "MTF50 / (cy/px)": lambda one: _text(one.figures.mtf50_cy_per_px),
                "MTF20 / (cy/px)": lambda one: _text(one.figures.mtf20_cy_per_px),
                "MTF10 / (cy/px)": lambda one: _text(one.figures.mtf10_cy_per_px),
                "MTF50, direct": lambda one: (
                    "" if one.direct_figures is None else _text(one.direct_figures.mtf50_cy_per_px)
                ),
                "area over that of the edges": lambda one: _text(one.over_edges),
            },
        ),
        ReportFigure.of(
            _plot_texture(first, lens),
            "Contrast by frequency of the first target, with 95 % bands, and of the edges "
            f"(all of colour {lens.main.colour}).",
        ),
    )


@in_report_style
def _plot_texture(texture: TextureFigures, lens: LensMeasurement) -> Figure:
    """Plot both curves and that of the edges."""
    figure, axes = new_plot(3.6, 2.6)
    freq = np.array(texture.freq_cy_per_px)
    curves = (
        ("direct", texture.direct, texture.direct_err, VERMILION),
        ("intrinsic", texture.intrinsic, texture.intrinsic_err, BLUE),
    )
    for label, values, errs, ink in curves:
        if values is None or errs is None:
            continue
        mtf, reach = np.array(values), NORMAL_95 * np.array(errs)
        axes.plot(freq, mtf, color=ink, linewidth=1.4, label=label)
        axes.fill_between(freq, mtf - reach, mtf + reach, color=ink, alpha=0.2, linewidth=0)
    edges = lens.main.sfr
    if edges is not None:
        axes.plot(edges.freq_cy_per_px, edges.mtf, color=INK, linewidth=1.0, label="edges")
    axes.axvline(0.25, color=POINTS, linewidth=0.8, linestyle=":")
    axes.set(xlabel="frequency / (cy/px)", ylabel="contrast", xlim=(0, 0.5), ylim=(0, None))
    axes.legend()
    return figure


def _information_section(capacity: CapacityFigures | None) -> ReportSection | None:
    if capacity is None:
        return None
    level, noise = f"{capacity.level_dn:.0f} DN", f"{capacity.noise_dn:.2f} DN"
    edge = capacity.edge_bits_per_px
    rows = [
        ("by transfer and noise, all frequencies", capacity.bits_per_px.estimate.text(2)),
        ("by edges alone (Koren)", "" if edge is None else edge.estimate.text(2)),
    ]
    if capacity.most_bits_per_px is not None:
        rows.append(("for all levels up to saturation", f"{capacity.most_bits_per_px:.2f}"))
    return ReportSection.of(
        "Noise-equivalent quanta, detection and information",
        f"At {level} above black, {capacity.level_of}, where a photograph has a noise of {noise} "
        f"(from {capacity.noise_from}, taken as white). An image with NEQ quanta a pixel and no "
        "blur would show a pattern of that frequency as well. An ideal observer knows the object "
        "and the camera exactly: nobody finds it with less contrast.",
        "An edge 100 px long, whose step is a tenth of the light, can be located to "
        f"{capacity.edge_location_err_px:.4f} px at best.",
        ReportTable.of(
            capacity.detection,
            {
                "object": lambda one: one.description,
                "SNR at 10 % contrast": lambda one: one.snr.estimate.text(2),
                "contrast seen with SNR 5": lambda one: f"{100 * one.threshold_contrast:.3g} %",
            },
        ),
        ReportTable(
            columns=("information capacity", "bits/px"),
            rows=tuple(rows),
            caption=f"Shannon's for real samples, between levels {capacity.range_dn:.0f} DN apart. "
            "The method by edges takes a round lens and the frequencies up to 0.5 cy/px in all "
            "directions (a disc); the integral takes all that the sampling passes (a square). "
            "Published figures by edges may leave out the half in Shannon's formula, and are then "
            "twice as large.",
        ),
        ReportFigure.of(
            _plot_neq(capacity), "Noise-equivalent quanta a pixel, mean over directions, 95 % band."
        ),
    )


@in_report_style
def _plot_neq(capacity: CapacityFigures) -> Figure:
    """Plot the noise-equivalent quanta against the frequency."""
    figure, axes = new_plot(3.6, 2.4)
    freq, neq = np.array(capacity.freq_cy_per_px), np.array(capacity.neq)
    reach = NORMAL_95 * np.array(capacity.neq_err)
    axes.semilogy(freq, neq, color=BLUE, linewidth=1.4)
    axes.fill_between(
        freq, np.maximum(neq - reach, 1e-3 * neq), neq + reach, color=BLUE, alpha=0.2, linewidth=0
    )
    axes.set(xlabel="frequency / (cy/px)", ylabel="NEQ / (quanta/px)", xlim=(0, 0.5))
    return figure


def _photographs_section(
    lens: LensMeasurement, load: Callable[[str], NDArray[np.floating[Any]]]
) -> ReportSection | None:
    if not lens.psf.edges:
        return None
    found = edges_section(
        lens.psf, list(lens.psf.edges), lambda edge: load(edge.image), 2, _PHOTOGRAPH_IN
    )
    return replace(found, title="Photographs", is_folded=True)


def _edges_section(lens: LensMeasurement) -> ReportSection:
    """The softest and the sharpest edges with their figures; the CSV file has all."""
    main = [edge for edge in lens.edges if edge.colour == lens.main.colour]
    ranked = sorted(main, key=lambda one: _value(one.figures, "mtf50_cy_per_px"))
    shown = ranked
    if len(ranked) > _EDGES_LISTED:
        half = _EDGES_LISTED // 2
        shown = [*ranked[:half], *ranked[-half:]]
    has_image = len({edge.image for edge in main}) > 1
    names = {
        (edge.image, edge.x_px, edge.y_px): edge_name(edge, has_image=has_image)
        for edge in lens.psf.edges_used
    }
    columns = ("MTF50", "MTF20", "at Nyquist", "rise / px", "overshoot")
    keys = ("mtf50_cy_per_px", "mtf20_cy_per_px", "mtf_at_nyquist", "rise_px", "overshoot")
    rows = tuple(
        (
            names[(one.image, one.x_px, one.y_px)] + " *" * (not one.figures.is_model_free),
            *(
                "" if known is None else with_reach(known.value, NORMAL_95 * known.err, 3)
                for known in (getattr(one.figures, key) for key in keys)
            ),
        )
        for one in shown
    )
    is_cut = len(ranked) > len(shown)
    return ReportSection.of(
        "Edges",
        "Frequencies in cy/px, softest edge first."
        + (
            f" The {_EDGES_LISTED // 2} softest and as many of the sharpest of {len(ranked)} edges;"
            " the CSV file has all, in every colour and unit."
            if is_cut
            else " The CSV file has them in every colour and unit."
        )
        + " *: of the fitted Gaussian." * any(not one.figures.is_model_free for one in shown),
        ReportTable(columns=("edge", *columns), rows=rows),
        is_folded=True,
    )


def _value(figures: EdgeFigures, name: str) -> float:
    known: MeasuredValue | None = getattr(figures, name)
    return float("inf") if known is None else known.value
