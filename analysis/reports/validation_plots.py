"""Figures 2 and 3: the processed images side by side, and the metrics against the zoom-out."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.comparison_plots import MODEL_COLOURS
from analysis.reports.page import in_report_style, new_figure
from analysis.validation import METRICS, PairValidation, Procedure, Validation, ValidationModel

__all__ = ["plot_curves", "plot_images"]

_COLOURS = {**MODEL_COLOURS, "kernelgan": "#E69F00", "gaussian-kernelgan": "#56B4E9"}
_LABELS = {
    "correlation": "correlation",
    "mse_dn2": "MSE",
    "nmi": "NMI",
    "psnr_db": "PSNR / dB",
    "ssim": "SSIM",
}
_CROP_PX = 130
_OURS = ("matched", "lmmse")
"""Models that are shown on the follow-up's grid, which they are made for."""


@in_report_style
def plot_images(validation: Validation) -> Figure:
    """Figure 2: reference, captured and simulated follow-ups after the processing.

    One row for every target; the middle of the processed images, all on the reference's pixels.
    """
    shown = [pair for pair in validation.pairs if pair.images is not None]
    columns = ["reference", "captured", *validation.models]
    figure = new_figure(1.35 * len(columns) + 0.2, 1.5 * len(shown) + 0.25)
    grid = figure.subplots(len(shown), len(columns), squeeze=False)
    for row, pair in zip(grid, shown, strict=True):
        assert pair.images is not None
        images = [pair.images.reference, pair.images.captured]
        images += [pair.images.simulated[_procedure(m), m] for m in validation.models]
        window = _middle(images[0].shape)
        reach = float(np.percentile(np.abs(images[1][window]), 99.5))
        for axes, image in zip(row, images, strict=True):
            axes.imshow(image[window], cmap="gray", vmin=-reach, vmax=reach)
            axes.set(xticks=[], yticks=[])
            axes.grid(visible=False)
        zoom = pair.registration.zoom
        row[0].set_ylabel(f"{pair.reference.target}, z = {zoom:.2f}")
    for axes, name in zip(grid[0], columns, strict=True):
        axes.set_title(name)
    return figure


@in_report_style
def plot_curves(validation: Validation) -> Figure:
    """Figure 3: every metric against the zoom-out, captured and simulated.

    A column for every target; the first reference's curves are drawn through, the others dashed.
    The paper's three models are scaled up onto the reference, ours made on the follow-up's grid.
    """
    targets = list(dict.fromkeys(_target(pair) for pair in validation.pairs))
    figure = new_figure(2.6 * len(targets) + 0.9, 8.6)
    grid = figure.subplots(len(METRICS), len(targets), sharex=True, squeeze=False)
    for number, target in enumerate(targets):
        pairs = [pair for pair in validation.pairs if _target(pair) == target]
        for metric, axes in zip(METRICS, grid[:, number], strict=True):
            _draw_metric(axes, pairs, metric, validation.models)
            if number == 0:
                axes.set_ylabel(_LABELS[metric])
        grid[0, number].set_title(
            target[0] if target[1] == 0 else f"{target[0]}, {target[1]:g} deg"
        )
        grid[-1, number].set_xlabel("zoom-out z")
    handles, names = grid[0, 0].get_legend_handles_labels()
    figure.legend(
        handles,
        names,
        loc="outside lower center",
        ncols=min(len(names), 2 * grid.shape[1]),
        fontsize=8,
    )
    return figure


def _draw_metric(
    axes: Axes, pairs: list[PairValidation], metric: str, models: tuple[ValidationModel, ...]
) -> None:
    references = list(dict.fromkeys(pair.reference.index for pair in pairs))
    for place, reference in enumerate(references):
        line = "-" if place == 0 else "--"
        chosen = [pair for pair in pairs if pair.reference.index == reference]
        zooms = [pair.registration.zoom for pair in chosen]
        for model in models:
            curve = [
                getattr(pair.models[_procedure(model), model].curve, metric) for pair in chosen
            ]
            label = model if place == 0 else None
            axes.plot(zooms, curve, line, color=_COLOURS[model], linewidth=1.2, label=label)
        captured = [getattr(pair.captured_curves["reference-grid"], metric) for pair in chosen]
        axes.plot(
            zooms, captured, line, color="black", marker="o", markersize=3, linewidth=1.0,
            label="captured" if place == 0 else None,
        )  # fmt: skip


def _procedure(model: ValidationModel) -> Procedure:
    return "followup-grid" if model in _OURS else "reference-grid"


def _target(pair: PairValidation) -> tuple[str, float]:
    return pair.reference.target, pair.reference.orientation_deg


def _middle(shape: tuple[int, ...]) -> tuple[slice, slice]:
    side = min(_CROP_PX, *shape)
    top, left = ((size - side) // 2 for size in shape)
    return slice(top, top + side), slice(left, left + side)
