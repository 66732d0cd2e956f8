"""The report of a noise calibration: photon transfer, linearity and the maps."""

import numpy as np
from matplotlib.figure import Figure

from analysis.reports.page import (
    Report,
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    in_report_style,
    new_figure,
    render_report,
)
from calibration.noise import (
    CorrectionMaps,
    Linearity,
    NoiseMeasurement,
    PhotonTransfer,
    draw_photon_transfer,
)
from calibration.sharpness import NORMAL_95, with_reach
from simulation.palette import BLUE, INK, VERMILION


@in_report_style
def _plot_photon_transfer(transfer: PhotonTransfer) -> Figure:
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
    figure = new_figure(6.4, 4.4)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1])
    draw_photon_transfer(upper, transfer)
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
def _plot_linearity(linearity: Linearity) -> Figure:
    """Plot the deviation of each level from a line through the exposures, in percent."""
    figure = new_figure(6.4, 2.6)
    axes = figure.subplots()
    axes.plot(
        linearity.light_dn, 100 * np.array(linearity.deviations), "o", markersize=4, color=BLUE
    )
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.margins(y=0.25)
    axes.set(xlabel="level above black / DN", ylabel="deviation from line / %", xlim=(0, None))
    return figure


@in_report_style
def _plot_maps(maps: CorrectionMaps) -> Figure:
    """Show the dark and the flat map, with the defect pixels circled."""
    rows, cols = maps.dark_dn.shape
    figure = new_figure(7.2, 3.3 * rows / cols + 0.6)
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


def render_noise_report(noise: NoiseMeasurement, source: str) -> str:
    """Return the report as one HTML page; ``source`` says where the captures are from."""
    transfer, known = noise.transfer, noise.calibration
    return render_report(
        Report(
            title="Camera noise",
            subtitle=f"{source}: {known.darks} dark and {known.flats} flat captures"
            + (f", {known.captured_utc[:10]}" if known.captured_utc else ""),
            verdicts=_verdicts(noise),
            sections=tuple(
                section
                for section in (
                    _transfer_section(noise),
                    _linearity_section(noise),
                    _maps_section(noise),
                    _captures_section(noise),
                )
                if section is not None
            ),
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
    )


def _verdicts(noise: NoiseMeasurement) -> tuple[Verdict, ...]:
    transfer = noise.transfer
    dark, saturation = transfer.dark, transfer.saturation
    return (
        Verdict(
            name="Gain",
            value=f"{transfer.gain_e_per_dn:.4f} e/DN",
            remark=_known(transfer.gain_e_per_dn, transfer.gain_e_per_dn_err, 4, "e/DN"),
        ),
        Verdict(
            name="Read noise",
            value=f"{transfer.read_noise_e:.3f} e",
            remark=_known(transfer.read_noise_e, transfer.read_noise_e_err, 3, "e"),
        ),
        Verdict(
            name="Black level",
            value=f"{dark.black_level_dn:.3f} DN",
            remark=_known(dark.black_level_dn, dark.black_level_dn_err, 3, "DN"),
        ),
        Verdict(
            name="Saturation",
            value=f"{saturation.level_dn:.0f} DN",
            remark=f"{transfer.saturation_e:.0f} e"
            if saturation.is_reached
            else "not reached; from the pixel format",
        ),
    )


def _known(value: float, err: float, digits: int, unit: str) -> str:
    return f"{with_reach(value, NORMAL_95 * err, digits)} {unit}"


def _transfer_section(noise: NoiseMeasurement) -> ReportSection:
    transfer = noise.transfer
    return ReportSection(
        title="Photon transfer",
        text=(
            "The variance of one frame rises with the light: its slope is 1 over the gain, its "
            "value without light the read noise (minus 1/12 DN² of rounding). Flats above 70 % of "
            "saturation are not fitted.",
            f"Scatter about the line: {transfer.chi2_reduced:.2f} times that expected from the "
            "number of pixels; above 1, the errors are widened by its square root.",
            *transfer.notes,
        ),
        figures=(
            ReportFigure.of(
                _plot_photon_transfer(transfer),
                "Mean of all good pixels of each capture. Below: deviation from the fit, with the "
                "95 % interval that the number of pixels gives.",
            ),
        ),
    )


def _linearity_section(noise: NoiseMeasurement) -> ReportSection | None:
    linearity = noise.transfer.linearity
    if linearity is None:
        return None
    drift = (
        "No exposure was captured twice, so a drift of the light counts as deviation."
        if linearity.light_drift_per_s is None
        else f"The light drifted by {100 * linearity.light_drift_per_s:.2g} % per second; this "
        "drift is removed."
    )
    return ReportSection(
        title="Linearity",
        text=(
            f"Mean deviation {100 * linearity.mean_deviation:.3f} %, worst "
            f"{100 * linearity.worst_deviation:.3f} %, between 5 and 95 % of saturation. {drift}",
        ),
        figures=(
            ReportFigure.of(_plot_linearity(linearity), "Deviation of the level from a line."),
        ),
    )


def _maps_section(noise: NoiseMeasurement) -> ReportSection:
    pixels, gain = noise.nonuniformity, noise.transfer.gain_e_per_dn
    return ReportSection(
        title="Sensor maps",
        text=(
            "The flat map contains the lens's fall-off, the unevenness of the light and the "
            "response of the pixels; it is valid only for this lens, aperture and light.",
        ),
        tables=(
            ReportTable(
                columns=("", "value"),
                rows=(
                    ("dark pattern (DSNU)", f"{gain * pixels.dsnu_dn:.2f} e"),
                    ("response pattern (PRNU)", f"{100 * pixels.prnu:.3f} %"),
                    ("shading, smallest to largest", f"{100 * pixels.shading:.1f} %"),
                    ("defect pixels", str(pixels.defects)),
                ),
                caption="Patterns are standard deviations between pixels, with temporal noise "
                "and large structures removed.",
            ),
        ),
        figures=(ReportFigure.of(_plot_maps(noise.maps), "Defects are circled.", "png"),),
    )


def _captures_section(noise: NoiseMeasurement) -> ReportSection:
    transfer = noise.transfer
    return ReportSection(
        title="Captures",
        is_folded=True,
        tables=(
            ReportTable(
                columns=("capture", "exposure / µs", "level / DN", "variance / DN²", "clipped", ""),
                rows=tuple(
                    (
                        sample.capture,
                        "" if sample.exposure_us is None else f"{sample.exposure_us:g}",
                        f"{sample.mean_dn:.3f}",
                        f"{sample.variance_dn2:.3f}",
                        f"{100 * sample.clipped_fraction:.2f} %",
                        "fitted" if sample.is_fitted else "not fitted",
                    )
                    for sample in transfer.samples
                ),
            ),
        ),
    )
