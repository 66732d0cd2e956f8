"""The figures of d' against zoom."""

import pytest
from matplotlib.figure import Figure

from analysis.choices import Observer
from analysis.detectability.curves import DetectabilityCurve
from analysis.detectability.plot import curves_figure
from simulation import Model

MODELS: tuple[Model, ...] = ("bicubic", "paper", "matched", "lmmse")


def figure_of(observers: list[Observer], noises_dn: list[float]) -> Figure:
    return curves_figure(
        [
            DetectabilityCurve(
                model=model,
                observer=observer,
                noise_dn=noise_dn,
                contrast_dn=12.0,
                signal_sigma_px=2.0,
                zoom=[1.0, 2.0],
                dprime=[4.0, 2.0],
                dprime_low=[3.9, 1.9],
                dprime_high=[4.1, 2.1],
                auc=[0.99, 0.9],
            )
            for model in MODELS
            for observer in observers
            for noise_dn in noises_dn
        ],
        "noise_dn",
    )


@pytest.mark.slow
@pytest.mark.parametrize("observers", [["npw"], ["npw", "hotelling", "cho"]])
@pytest.mark.parametrize("noises_dn", [[2.0], [2.125, 4.25, 8.5, 17.75, 35.25, 123456.0]])
def test_the_legend_lies_within_the_figure_and_below_the_panels(
    observers: list[Observer], noises_dn: list[float]
) -> None:
    figure = figure_of(observers, noises_dn)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert figure.bbox.x0 <= box.x0
    assert box.x1 <= figure.bbox.x1
    assert figure.bbox.y0 <= box.y0
    panel = figure.axes[0].get_tightbbox()
    assert panel is not None
    assert box.y1 <= panel.y0
    # Every model and every noise has its entry.
    assert len(legend.get_texts()) == len(MODELS) + len(noises_dn)
    # The panels keep most of the height.
    assert figure.axes[0].get_window_extent().height > 0.4 * figure.bbox.height
