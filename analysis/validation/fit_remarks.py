"""Where the models do not fit the captures of a session, in sentences."""

from collections.abc import Iterator, Sequence

from analysis.choices import ValidationModel
from analysis.validation.document import ValidatedPair
from simulation.choices import POSE_MODELS

_FITS = 2.0
"""Reduced chi-squared up to which a model fits: what it states of its own error is an average."""

_NAMED = 3


def fit_remarks(pairs: Sequence[ValidatedPair], models: Sequence[ValidationModel]) -> Iterator[str]:
    """Say of the better of ``matched`` and ``lmmse`` in which pairs it does not fit.

    The other models leave more than physics needs, and say nothing of the captures.
    """
    physical = [model for model in models if model in POSE_MODELS]
    if not physical:
        return
    known = [pair for pair in pairs if pair.chi2_reduced]
    if not known:
        return
    if len(known) < len(pairs):
        yield (
            f"{len(pairs) - len(known)} of {len(pairs)} pairs have captures of a single frame: "
            "without their noise, how well the models fit is not known"
        )
    model = min(physical, key=lambda one: sum(pair.chi2_reduced[one] for pair in known))
    worst = sorted(known, key=lambda pair: -pair.chi2_reduced[model])
    beyond = [pair for pair in worst if pair.chi2_reduced[model] > _FITS]
    if not beyond:
        return
    named = ", ".join(
        f"{pair.target} {pair.reference_height_mm:g} to {pair.followup_height_mm:g} mm "
        f"({pair.chi2_reduced[model]:.1f})"
        for pair in beyond[:_NAMED]
    )
    more = "" if len(beyond) <= _NAMED else ", ..."
    yield (
        f"model {model} does not fit {len(beyond)} of {len(known)} pairs: more is left than noise, "
        "PSF, alignment and the model's own error explain, worst (reduced chi-squared) "
        f"{named}{more}; check whether the PSF is that of this lens, and focus and light"
    )
