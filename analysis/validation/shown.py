"""The processed images that figures show, recomputed from the captures of a validation."""

from collections.abc import Mapping
from dataclasses import dataclass

from acquisition.session import Session
from analysis.choices import ValidationModel
from analysis.validation.alignment import Procedure
from analysis.validation.document import ValidatedPair, Validation
from analysis.validation.kernels import KernelBook
from analysis.validation.models import ModelInputs
from analysis.validation.pair import AlignedPair
from simulation import MODELS, Psf
from simulation.arrays import FloatArray

_SHOWN_ZOOM = 2.0
"""Figure 2 shows the follow-up that is nearest to it."""

_OURS = ("matched", "lmmse")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShownPair:
    """Processed images of a pair on common pixels: captured, and as the models simulate them."""

    pair: ValidatedPair
    reference: FloatArray
    captured: FloatArray
    simulated: Mapping[ValidationModel, FloatArray]


def drawn_procedure(model: ValidationModel) -> Procedure:
    """Procedure by which figures show a model: ours on the grid that they are made for."""
    return "followup-grid" if model in _OURS else "reference-grid"


def shown_pairs(
    session: Session, validation: Validation, psf: Psf, book: KernelBook
) -> list[ShownPair]:
    """Images for Figure 2, all on the reference's pixels: one pair of every target."""
    shown = []
    for pair in _typical_pairs(validation.pairs):
        images = _aligned(session, pair)
        inputs = book.inputs(images.reference, validation.models, pair.zoom, psf)
        shown.append(
            ShownPair(
                pair=pair,
                reference=images.processed_reference(),
                captured=images.captured_on_reference(),
                simulated={model: _on_reference(images, inputs, model) for model in inputs.kernels},
            )
        )
    return shown


def furthest_pair(session: Session, validation: Validation, psf: Psf) -> ShownPair:
    """Images of the pair with the largest zoom, on the follow-up's pixels.

    Simulated by every model that needs no training.
    """
    pair = max(validation.pairs, key=lambda pair: pair.zoom)
    images = _aligned(session, pair)
    inputs = ModelInputs(psf=psf, kernels=dict.fromkeys(MODELS))
    made = {model: images.on_followup_grid(inputs, model) for model in MODELS}
    return ShownPair(
        pair=pair,
        reference=images.processed_reference(),
        captured=made[MODELS[0]].captured,
        simulated={model: one.followup for model, one in made.items()},
    )


def _aligned(session: Session, pair: ValidatedPair) -> AlignedPair:
    records = {record.index: record for record in session.records}
    near, far = (session.load(records[index]).mean_dn for index in (pair.reference, pair.followup))
    shapes = [(image.shape[0], image.shape[1]) for image in (near, far)]
    return AlignedPair(reference=near, followup=far, pose=pair.pose(*shapes))


def _on_reference(images: AlignedPair, inputs: ModelInputs, model: ValidationModel) -> FloatArray:
    if drawn_procedure(model) == "followup-grid":
        return images.on_followup_grid(inputs, model).aligned
    return images.scaled_up(inputs, model)


def _typical_pairs(pairs: tuple[ValidatedPair, ...]) -> list[ValidatedPair]:
    """One pair of every target: the first reference's, about twice as far away."""
    best: dict[tuple[str, float], ValidatedPair] = {}
    for pair in pairs:
        kept = best.setdefault((pair.target, pair.orientation_deg), pair)
        is_nearer = abs(pair.zoom - _SHOWN_ZOOM) < abs(kept.zoom - _SHOWN_ZOOM)
        if pair.reference == kept.reference and is_nearer:
            best[pair.target, pair.orientation_deg] = pair
    return list(best.values())
