"""How well models predict captured follow-ups: Tables I and II of a whole session.

Table I compares curves: how a metric between the reference and the follow-up falls with the
distance, once for the captured and once for the simulated follow-ups. Table II compares the
follow-ups themselves. ``docs/validation.md`` holds the definitions.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import inf, log10

import numpy as np

from acquisition.session import Session
from analysis.choices import PAPER_TRAINING_STEPS, ValidationModel
from analysis.validation._document import (
    METRICS,
    CurveDifference,
    CurveDifferenceRow,
    MeanRow,
    ModelMean,
    ValidatedPair,
    Validation,
    fit_remarks,
    psf_sha256,
)
from analysis.validation._kernels import KernelBook, ModelInputs, default_cache_folder, is_learned
from analysis.validation._metrics import PROCEDURES, ImageMetrics, Procedure
from analysis.validation._pair import (
    AlignedPair,
    Expectation,
    PairErrors,
    compare_pair,
    noise_variance,
)
from analysis.validation._screening import RegisteredPair, Screening, screen
from calibration.psf import PsfCalibration
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


def _default_kernels() -> KernelBook:
    return KernelBook(folder=default_cache_folder())


@dataclass(frozen=True, slots=True, kw_only=True)
class ValidationSettings:
    """How a validation is made.

    ``models``: the models to try; by default those that need no training. ``kernels``: kernels of
    the learned ones; what is missing is trained. ``references``: reference poses of every target,
    from the nearest. ``workers``: processes that train kernels. ``calibration``: the calibration of
    the PSF, which states its errors; None if there is none.
    """

    models: tuple[ValidationModel, ...] = MODELS
    kernels: KernelBook = field(default_factory=_default_kernels)
    references: int = 2
    workers: int = 1
    calibration: PsfCalibration | None = None

    def steps_of(self, model: ValidationModel) -> int | None:
        """Training steps of a learned model, None for the others."""
        return self.kernels.steps if is_learned(model) else None


def validated(
    session: Session,
    psf: Psf,
    settings: ValidationSettings | None = None,
    *,
    screening: Screening | None = None,
    psf_name: str = "",
    progress: Callable[[int], None] = lambda _: None,
) -> Validation:
    """Say how well every model predicts the captured follow-ups of a session.

    ``session``: with captures of kind texture or chart at two heights or more. ``screening``:
    result of the screening, if it has been done already.
    """
    settings = settings or ValidationSettings()
    if screening is None:
        screening = screen(session, psf, references=settings.references)
    pairs: list[ValidatedPair] = []
    for pair in screening.pairs:
        pairs.append(_validated(session, pair, psf, settings))
        progress(len(pairs))
    rows = tuple(product(PROCEDURES, settings.models))
    return Validation(
        session=str(session.path),
        psf=psf_name,
        psf_covariance_px2=psf.covariance_px2.tolist(),
        psf_form=psf.form,
        psf_sha256=psf_sha256(psf),
        models=settings.models,
        references_per_target=settings.references,
        training_steps=settings.kernels.steps,
        training_seed=settings.kernels.seed,
        table_1=tuple(
            CurveDifferenceRow(
                alignment=alignment,
                model=model,
                training_steps=settings.steps_of(model),
                **dict(
                    curve_differences(
                        (p.captured_curves[alignment], p.of(alignment, model).curve) for p in pairs
                    )
                ),
            )
            for alignment, model in rows
        ),
        table_2=tuple(
            MeanRow(
                alignment=alignment,
                model=model,
                training_steps=settings.steps_of(model),
                **dict(mean_metrics([p.of(alignment, model).agreement for p in pairs])),
            )
            for alignment, model in rows
        ),
        pairs=tuple(pairs),
        excluded=screening.excluded,
        remarks=(
            *screening.remarks,
            *_training_remarks(settings),
            *fit_remarks(pairs, settings.models),
        ),
    )


def _training_remarks(settings: ValidationSettings) -> Iterator[str]:
    for model in filter(is_learned, settings.models):
        steps = settings.kernels.steps
        verdict = (
            f"but the paper used {PAPER_TRAINING_STEPS}, so the figures here say little about this "
            "model"
            if steps < PAPER_TRAINING_STEPS
            else "as many as the paper's, or more"
        )
        yield f"{model} was trained in {steps} steps, {verdict}"


def _validated(
    session: Session, pair: RegisteredPair, psf: Psf, settings: ValidationSettings
) -> ValidatedPair:
    registration = pair.registration
    near, far = session.load(pair.reference), session.load(pair.followup)
    aligned = AlignedPair(reference=near.mean_dn, followup=far.mean_dn, pose=registration.pose)
    compared = compare_pair(
        aligned,
        registration.feature_matrix,
        settings.kernels.inputs(near.mean_dn, settings.models, registration.zoom, psf),
    )
    near_dn2, far_dn2 = noise_variance(near), noise_variance(far)
    chi2: dict[ValidationModel, float] = {}
    if near_dn2 is not None and far_dn2 is not None:
        errors = PairErrors(
            reference_dn2=near_dn2,
            followup_dn2=far_dn2,
            place_err_px=registration.place_err_px,
            psf=psf,
            calibration=settings.calibration,
        )
        expected = Expectation.of(aligned, errors)
        chi2 = {model: expected.chi2_reduced(made) for model, made in compared.levels.items()}
    return ValidatedPair(
        target=pair.reference.target,
        orientation_deg=pair.reference.orientation_deg,
        reference=pair.reference.index,
        followup=pair.followup.index,
        reference_height_mm=pair.reference.height_mm,
        followup_height_mm=pair.followup.height_mm,
        zoom=registration.zoom,
        homography=registration.pose.matrix.tolist(),
        k1=registration.pose.k1,
        k1_err=registration.k1_err,
        place_err_px=registration.place_err_px,
        match_rms_px=registration.match_rms_px,
        matches=registration.inlier_count,
        captured_curves=dict(compared.captured_curves),
        models=compared.models,
        chi2_reduced=chi2,
    )


def curve_differences(points: Iterable[tuple[ImageMetrics, ImageMetrics]]) -> CurveDifference:
    """Mean squared difference of two curves, given as pairs of points.

    A PSNR that is infinite on both curves does not differ.
    """
    pairs = list(points)
    if not pairs:
        raise ValueError("no curve points to compare")
    means = {}
    for name in METRICS:
        first, second = np.array([[getattr(m, name) for m in pair] for pair in pairs]).T
        differs = first != second
        means[name] = float(np.sum((first[differs] - second[differs]) ** 2)) / len(pairs)
    return CurveDifference(**means, pairs=len(pairs))


def mean_metrics(metrics: Sequence[ImageMetrics]) -> ModelMean:
    """Average the metrics of several pairs of equal data range."""
    if not metrics:
        raise ValueError("no pairs to average")
    means = {name: float(np.mean([getattr(m, name) for m in metrics])) for name in METRICS}
    mse_dn2 = means["mse_dn2"]
    return ModelMean(
        **means,
        psnr_of_mean_db=10 * log10(metrics[0].data_range_dn ** 2 / mse_dn2) if mse_dn2 > 0 else inf,
        pairs=len(metrics),
    )
