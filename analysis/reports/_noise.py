"""The report of a noise calibration: photon transfer, linearity and the maps."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from analysis.reports._page import (
    Report,
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    in_report_style,
    new_figure,
    new_plot,
    number_text,
    present,
)
from calibration.estimate import NORMAL_95, with_reach
from calibration.noise import (
    CorrectionMaps,
    Linearity,
    NoiseMeasurement,
    PhotonTransfer,
    draw_photon_transfer,
)
from simulation.palette import BLUE, INK, POINTS, VERMILION


@in_report_style
def _plot_photon_transfer(transfer: PhotonTransfer, width_in: float = 6.4) -> Figure:
    """Plot the variance of a frame against the light, the fit, and the residuals in percent."""
    black = transfer.dark.black_level_dn
    light = np.array([sample.mean_dn - black for sample in transfer.samples])
    variance = np.array([sample.variance_dn2 for sample in transfer.samples])
    err = np.array(
        [
            sample.variance_dn2 * np.sqrt(2 / ((sample.frames - 1) * sample.pixels))
            for sample in transfer.samples
        ]
    )
    fitted = np.array([sample.is_fitted for sample in transfer.samples])
    figure = new_figure(width_in, 0.4 * width_in + 1.84)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1])
    draw_photon_transfer(upper, transfer)
    upper.set_ylabel("variance / DN²")
    expected = transfer.variance_dn2(light)
    lower.errorbar(
        light[fitted], 100 * (variance / expected - 1)[fitted],
        yerr=100 * NORMAL_95 * (err / expected)[fitted],
        fmt="o", markersize=4, linewidth=0.9, color=BLUE,
    )  # fmt: skip
    lower.axhline(0, color=INK, linewidth=0.8)
    lower.margins(y=0.25)
    lower.set(xlabel="level above black / DN", ylabel="variance\nresidual / %")
    return figure


@in_report_style
def _plot_linearity(linearity: Linearity, width_in: float = 6.4) -> Figure:
    """Plot the deviation of each level from a line through the exposures, in percent."""
    figure, axes = new_plot(width_in, 2.6)
    axes.plot(
        linearity.light_dn, 100 * np.array(linearity.deviations), "o", markersize=4, color=BLUE
    )
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.margins(y=0.25)
    axes.set(xlabel="above black / DN", ylabel="deviation from line / %", xlim=(0, None))
    return figure


@in_report_style
def _plot_maps(maps: CorrectionMaps, width_in: float = 7.2) -> Figure:
    """Show the dark and the flat map, with the defect pixels circled."""
    rows, cols = maps.dark_dn.shape
    figure = new_figure(width_in, 0.46 * width_in * rows / cols + 0.6)
    y, x = np.nonzero(maps.defects)
    for axes, image, title in zip(
        figure.subplots(1, 2),
        (maps.dark_dn, maps.response),
        ("dark map / DN", "flat map, mean 1"),
        strict=True,
    ):
        low, high = np.percentile(image, [0.5, 99.5])
        shown = axes.imshow(image, cmap="viridis", vmin=low, vmax=max(high, low + 1e-9))
        axes.plot(x, y, "o", markersize=7, markerfacecolor="none", color=VERMILION, linewidth=1)
        axes.set(title=title, xlabel="x / px", xlim=(-0.5, cols - 0.5), ylim=(rows - 0.5, -0.5))
        axes.grid(visible=False)
        figure.colorbar(shown, ax=axes, shrink=0.8)
    return figure


def noise_report(noise: NoiseMeasurement, source: str) -> Report:
    """Return the report; ``source`` says where the captures are from."""
    transfer, known = noise.transfer, noise.calibration
    return Report(
        title="Camera noise",
        subtitle=f"{source}: {known.darks} dark and {known.flats} flat captures"
        + (f", {known.captured_utc[:10]}" if known.captured_utc else ""),
        verdicts=_verdicts(noise),
        sections=noise_sections(noise),
        provenance=(
            (
                "camera",
                f"{known.camera_model or 'unknown'}, {known.camera_serial or 'no serial'}",
            ),
            ("gain", "unknown" if known.gain_db is None else f"{known.gain_db:g} dB"),
            ("pixel format", known.pixel_format or "unknown"),
            ("fitted levels", f"{transfer.fit_low_dn:.0f} to {transfer.fit_high_dn:.0f} DN"),
        ),
        origin=known.provenance,
    )


def noise_sections(noise: NoiseMeasurement) -> tuple[ReportSection, ...]:
    """Return the sections on a noise measurement, the data sheet first."""
    return present(
        _sheet_section(noise),
        _transfer_section(noise.transfer),
        _linearity_section(noise.transfer.linearity),
        _pattern_section(noise),
        _maps_section(noise),
        _captures_section(noise.transfer),
    )


def _sheet_section(noise: NoiseMeasurement) -> ReportSection:
    return ReportSection.of(
        _SHEET,
        *_sheet_parts(noise),
        ReportFigure.of(_plot_snr(noise), _SNR_CAPTION),
    )


def camera_section(noise: NoiseMeasurement) -> ReportSection:
    """Return the data sheet with all of its plots, on a page and a half."""
    linearity, narrow_in = noise.transfer.linearity, 2.1
    return ReportSection.of(
        _SHEET,
        *_sheet_parts(noise),
        ReportFigure.of(
            _plot_photon_transfer(noise.transfer, 2.9),
            "Photon transfer: variance of a frame against the light, fit and residuals.",
        ),
        ReportFigure.of(_plot_snr(noise, narrow_in), _SNR_CAPTION),
        None
        if linearity is None
        else ReportFigure.of(
            _plot_linearity(linearity, narrow_in), "Deviation of the level from a line."
        ),
        ReportFigure.of(
            _plot_spectra(noise),
            "Spectra of the nonuniformity along rows and columns. Dotted: the temporal noise left "
            "in the maps.",
        ),
        ReportFigure.of(
            _plot_maps(noise.maps, 5.6), "Dark and flat map. Defects are circled.", "png"
        ),
    )


_SHEET = "EMVA 1288 data sheet, linear model"
_SNR_CAPTION = "SNR of a pixel by temporal noise, and with its pattern; dashed: an ideal sensor."


def _sheet_parts(noise: NoiseMeasurement) -> tuple[str | ReportTable | None, ...]:
    sheet = noise.emva
    rows = tuple(
        (
            row.name,
            row.symbol,
            with_reach(row.value, None if row.err is None else NORMAL_95 * row.err, row.digits),
            row.unit,
        )
        for row in sheet.rows()
    )
    return (
        "Release 4. The light is not calibrated in photons: there is no quantum efficiency, and "
        "what the standard states in photons is stated in electrons.",
        ReportTable(
            columns=("", "symbol", "value", "unit"),
            rows=rows,
            caption="Patterns are those of maps averaged over captures, without defect pixels and "
            "the temporal noise left in them; of the response, without shading.",
        ),
    )


@in_report_style
def _plot_snr(noise: NoiseMeasurement, width_in: float = 6.4) -> Figure:
    """Plot SNR against the signal: of one pixel over time, with all pixels, and of shot noise."""
    sheet = noise.emva
    signal_e = np.geomspace(max(0.5 * sheet.threshold_e, 0.1), sheet.saturation_e, 200)
    temporal = np.sqrt(signal_e + (sheet.threshold_e - 0.5) ** 2)
    pattern = np.hypot(sheet.dsnu_e.total, sheet.prnu.total * signal_e)
    figure, axes = new_plot(width_in, 2.8)
    axes.loglog(signal_e, signal_e / temporal, color=BLUE, linewidth=1.4, label="temporal")
    axes.loglog(
        signal_e, signal_e / np.hypot(temporal, pattern), color=VERMILION, linewidth=1.2,
        label="with pattern",
    )  # fmt: skip
    axes.loglog(signal_e, np.sqrt(signal_e), color=INK, linewidth=0.8, linestyle="--")
    axes.axvline(sheet.threshold_e, color=POINTS, linewidth=0.8, linestyle=":")
    axes.set(xlabel="signal / e", ylabel="SNR")
    axes.legend(fontsize=8, handlelength=1.2)
    return figure


def _pattern_section(noise: NoiseMeasurement) -> ReportSection:
    return ReportSection.of(
        "Nonuniformity spectra",
        "A peak is a pattern that repeats: lines of a readout, or interference. White noise is a "
        "level line.",
        ReportFigure.of(
            _plot_spectra(noise),
            "Amplitude along rows and along columns. Dotted: the temporal noise left in the maps.",
        ),
    )


@in_report_style
def _plot_spectra(noise: NoiseMeasurement) -> Figure:
    """Plot the spectra of DSNU and PRNU along both axes."""
    gain, pixels = noise.transfer.gain_e_per_dn, noise.nonuniformity
    figure = new_figure(7.2, 2.2)
    for axes, spectra, factor, label in zip(
        figure.subplots(1, 2),
        (pixels.dark_spectra_dn, pixels.response_spectra),
        (gain, 100.0),
        ("DSNU / e", "PRNU / %"),
        strict=True,
    ):
        axes.semilogy(
            spectra.freq_x_cy_per_px[1:], factor * spectra.along_x[1:], color=BLUE, linewidth=0.8,
            label="along rows",
        )  # fmt: skip
        axes.semilogy(
            spectra.freq_y_cy_per_px[1:], factor * spectra.along_y[1:], color=VERMILION,
            linewidth=0.8, label="along columns",
        )  # fmt: skip
        axes.axhline(factor * spectra.temporal, color=INK, linewidth=0.8, linestyle=":")
        axes.set(xlabel="frequency / (cy/px)", ylabel=label, xlim=(0, 0.5))
        # Often less than a decade is shown, which powers of ten do not label.
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        low, high = axes.get_ylim()
        middle, ratio = (low * high) ** 0.5, max((high / low) ** 0.5, _LEAST_SPECTRUM_RATIO)
        axes.set_ylim(middle / ratio, middle * ratio)
    axes.legend()
    return figure


_LEAST_SPECTRUM_RATIO = 3.0
"""Of the end of a spectrum's axis to its middle: white noise is a level line."""


def _verdicts(noise: NoiseMeasurement) -> tuple[Verdict, ...]:
    transfer = noise.transfer
    dark, saturation = transfer.dark, transfer.saturation
    measured = (
        ("Gain", transfer.gain_e_per_dn, transfer.gain_e_per_dn_err, 4, "e/DN"),
        ("Read noise", transfer.read_noise_e, transfer.read_noise_e_err, 3, "e"),
        ("Black level", dark.black_level_dn, dark.black_level_dn_err, 3, "DN"),
    )
    electrons = f"{transfer.saturation_e:.0f} e"
    return (
        *(
            Verdict(
                name,
                f"{value:.{digits}f} {unit}",
                f"{with_reach(value, NORMAL_95 * err, digits)} {unit}",
            )
            for name, value, err, digits, unit in measured
        ),
        Verdict(
            "Saturation",
            f"{saturation.level_dn:.0f} DN",
            electrons if saturation.is_reached else "not reached; from the pixel format",
        ),
    )


def _transfer_section(transfer: PhotonTransfer) -> ReportSection:
    return ReportSection.of(
        "Photon transfer",
        "The variance of one frame rises with the light: its slope is 1 over the gain, its "
        "value without light the read noise (minus 1/12 DN² of rounding). Flats above 70 % of "
        "saturation are not fitted.",
        f"Scatter about the line: {transfer.chi2_reduced:.2f} times that expected from the "
        "number of pixels; above 1, the errors are widened by its square root.",
        *transfer.notes,
        ReportFigure.of(
            _plot_photon_transfer(transfer),
            "Mean of all good pixels of each capture. Below: deviation from the fit, with the "
            "95 % interval that the number of pixels gives.",
        ),
    )


def _linearity_section(linearity: Linearity | None) -> ReportSection | None:
    if linearity is None:
        return None
    drift = (
        "No exposure was captured twice, so a drift of the light counts as deviation."
        if linearity.light_drift_per_s is None
        else f"The light drifted by {100 * linearity.light_drift_per_s:.2g} % per second; this "
        "drift is removed."
    )
    return ReportSection.of(
        "Linearity",
        f"Mean deviation {100 * linearity.mean_deviation:.3f} %, worst "
        f"{100 * linearity.worst_deviation:.3f} %, between 5 and 95 % of saturation. {drift}",
        ReportFigure.of(_plot_linearity(linearity), "Deviation of the level from a line."),
    )


def _maps_section(noise: NoiseMeasurement) -> ReportSection:
    pixels = noise.nonuniformity
    return ReportSection.of(
        "Sensor maps",
        "The flat map contains the lens's fall-off, the unevenness of the light and the "
        "response of the pixels; it is valid only for this lens, aperture and light.",
        ReportTable(
            columns=("", "value"),
            rows=(
                ("shading, smallest to largest", f"{100 * pixels.shading:.1f} %"),
                ("defect pixels", str(pixels.defects)),
            ),
        ),
        ReportFigure.of(_plot_maps(noise.maps), "Defects are circled.", "png"),
    )


def _captures_section(transfer: PhotonTransfer) -> ReportSection:
    return ReportSection.of(
        "Captures",
        ReportTable.of(
            transfer.samples,
            {
                "capture": lambda one: one.capture,
                "exposure / µs": lambda one: number_text(one.exposure_us, "g"),
                "level / DN": lambda one: f"{one.mean_dn:.3f}",
                "variance / DN²": lambda one: f"{one.variance_dn2:.3f}",
                "clipped": lambda one: f"{100 * one.clipped_fraction:.2f} %",
                "": lambda one: "fitted" if one.is_fitted else "not fitted",
            },
        ),
        is_folded=True,
    )
