"""Curves of d' against zoom: the task, and its evaluation on images."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.choices import OBSERVERS, REFERENCE_ZOOM, WINDOW_PX, Observer
from analysis.detectability._artefact import ArtefactTiles, auc_of
from analysis.detectability._compared import compared_change, comparison_d_prime
from analysis.detectability._curves import (
    CurveUncertainty,
    DetectabilityCurve,
    DetectabilityCurves,
    ErrorSources,
)
from analysis.detectability._dprime import (
    DPrime,
    capture_response,
    d_primes,
    gaussian_psf,
    response_scenes,
    softer_psf,
)
from analysis.detectability._scenario import ChangeSignal, GaussianSignal, Scenario, local_changes
from analysis.detectability._sweep import SweepPlan, scene_sums, tiles_per_side
from simulation import Model, Psf
from simulation.arguments import ArgumentError, check_fields
from simulation.arrays import FloatArray

Found = dict[tuple[Observer, float], list[DPrime]]
"""d' of contrast 1 at each zoom, by observer and noise."""

Seen = dict[str, list[float]]

_USUAL_ZOOMS = (1.0, 1.01, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionTask:
    """A detection task: the change to detect, and the noises, zooms, models and observers.

    Parameters
    ----------
    signal
        The change to detect, of contrast 1 on the photograph; by default a Gaussian spot of sigma
        2 px.
    contrasts_dn
        Peaks of the change, in DN.
    noises_dn
        Standard deviations of the white noise in either image, in DN.
    zooms
        Ratios of the follow-up's distance to the reference's, rising, from 1.
    models
        Capture models; all but ``bicubic`` need a PSF.
    observers
        Observers to evaluate.
    reference_zoom
        Ratio of the reference's distance to the distance that the photograph was taken from.
    window_px
        Side of the observer's window on the reference, an odd number of pixels.
    seed
        Seed of the bootstrap over photographs.
    sources
        Errors of the camera, for the intervals.

    Raises
    ------
    ArgumentError
        If the zooms do not rise from 1 or more, or another value is not possible.

    Examples
    --------
    >>> task = standoff.DetectionTask(zooms=(1.0, 1.5), models=("bicubic",), observers=("npw",))
    >>> len(standoff.d_prime_curves("before.tif", task=task).curves)
    3
    """

    signal: ChangeSignal = field(default_factory=GaussianSignal)
    contrasts_dn: tuple[float, ...] = (12.0,)
    noises_dn: tuple[float, ...] = (1.0, 2.0, 4.0)
    zooms: tuple[float, ...] = _USUAL_ZOOMS
    models: tuple[Model, ...] = ("bicubic", "paper", "matched")
    observers: tuple[Observer, ...] = OBSERVERS
    reference_zoom: float = REFERENCE_ZOOM
    window_px: int = WINDOW_PX
    seed: int = 0
    sources: ErrorSources = field(default_factory=ErrorSources)

    def __post_init__(self) -> None:
        check_fields(self)
        if np.any(np.diff(self.zooms) <= 0):
            raise ArgumentError(f"expected rising numbers, got {self.zooms}", argument="zooms")
        for name in ("noises_dn", "contrasts_dn"):
            if not min(getattr(self, name)) > 0:
                raise ArgumentError(
                    f"expected numbers above 0, got {min(getattr(self, name)):g}", argument=name
                )
        for name in ("noises_dn", "contrasts_dn", "models", "observers"):
            if len(set(getattr(self, name))) < len(getattr(self, name)):
                raise ArgumentError(f"a value is repeated: {getattr(self, name)}", argument=name)
        if self.window_px % 2 == 0:
            raise ArgumentError(
                f"expected an odd number, got {self.window_px}", argument="window_px"
            )

    def plan(self, psf: Psf | None, images: int) -> SweepPlan:
        """Return what is measured on each photograph, if there are ``images`` of them."""
        return SweepPlan(
            scenario=Scenario(
                psf=psf, reference_zoom=self.reference_zoom, window_px=self.window_px
            ),
            models=self.models,
            zooms=self.zooms,
            tiles_per_side=tiles_per_side(images),
            is_compared="changes" in self.observers,
        )


def curves_of_images(
    images: Sequence[FloatArray], psf: Psf | None, task: DetectionTask | None = None
) -> DetectabilityCurves:
    """Compute how well a change can be detected at best, from different distances.

    ``images``: photographs of the scene, grey, shape ``(rows, cols)`` each, finite. ``psf``: total
    PSF of the photographs; None for model ``bicubic`` alone. Returns a curve for every model,
    observer, noise and contrast.
    """
    if not images:
        raise ValueError("no images: a curve needs at least one")
    task = task or DetectionTask()
    plan = task.plan(psf, len(images))
    scenes = [scene_sums(image, plan) for image in images]

    def artefacts(model: int) -> list[ArtefactTiles]:
        return [
            ArtefactTiles.joined([scene.artefact(model, zoom) for scene in scenes])
            for zoom in range(len(plan.zooms))
        ]

    return curves_of(artefacts, len(images), plan, task, some=images)


def curves_of(
    artefacts: Callable[[int], Sequence[ArtefactTiles]],
    images: int,
    plan: SweepPlan,
    task: DetectionTask,
    progress: Callable[[int], None] = lambda _: None,
    some: Sequence[FloatArray] = (),
) -> DetectabilityCurves:
    """Compute the curves from the artefact of measured images.

    ``artefacts``: artefact of the plan's model with this index at each of its zooms, in a fixed
    order; after those of all models come the residuals of their comparisons. ``plan``: what was
    measured on them; its models and zooms count. ``some``: a few of the images, on which is
    measured what errors of the capture do; without them the intervals hold the choice of images
    alone.
    """
    curves: list[DetectabilityCurve] = []
    psf, scenes = plan.scenario.psf, response_scenes(some)
    for number, model in enumerate(plan.models):
        found = _linear_observers(model, artefacts(number), scenes, plan, task)
        seen: Seen = {}
        if "changes" in task.observers:
            residuals = artefacts(len(plan.models) + number)
            compared, seen = _comparisons(model, residuals, plan, task)
            found.update(compared)
        curves += _curves_of_model(model, found, seen, task, plan.zooms)
        progress(number + 1)
    return DetectabilityCurves(
        images=images,
        reference_zoom=plan.scenario.reference_zoom,
        window_px=plan.scenario.window_px,
        signal=task.signal.name,
        psf_form=None if psf is None else psf.form,
        curves=curves,
    ).with_need()


def _linear_observers(
    model: Model,
    artefacts: Sequence[ArtefactTiles],
    scenes: Sequence[FloatArray],
    plan: SweepPlan,
    task: DetectionTask,
) -> Found:
    found: Found = {}
    observers = tuple(name for name in task.observers if name != "changes")
    if not observers:
        return found
    for zoom, artefact in zip(plan.zooms, artefacts, strict=True):
        changes = local_changes(task.signal, plan.scenario, model, zoom)
        response = None
        if scenes:
            response = capture_response(scenes, task.signal, plan.scenario, model, zoom)
        for noise_dn in task.noises_dn:
            results = d_primes(
                changes, artefact, noise_dn, observers, seed=task.seed, response=response
            )
            for observer, result in results.items():
                found.setdefault((observer, noise_dn), []).append(result)
    return found


def _comparisons(
    model: Model, residuals: Sequence[ArtefactTiles], plan: SweepPlan, task: DetectionTask
) -> tuple[Found, Seen]:
    """Observer ``changes``, and the spots that it saw by name of their lists, of contrast 1."""
    found: Found = {}
    spots = []
    for zoom, residual in zip(plan.zooms, residuals, strict=True):
        change = compared_change(task.signal, plan.scenario, model, zoom)
        narrow, wide = (
            compared_change(task.signal, replace(plan.scenario, psf=psf), model, zoom)
            for psf in (gaussian_psf(plan.scenario.psf), softer_psf(plan.scenario.psf))
        )
        spots.append(change.spot)
        for noise_dn in task.noises_dn:
            result = comparison_d_prime(
                change, residual, noise_dn, seed=task.seed, by_psf=(narrow, wide)
            )
            found.setdefault(("changes", noise_dn), []).append(result)
    known = [spot for spot in spots if spot is not None]
    if len(known) < len(spots):
        return found, {}
    return found, {
        "sigma_px": [spot.sigma_px for spot in known],
        "peak": [spot.peak for spot in known],
    }


def _curves_of_model(
    model: Model, found: Found, seen: Seen, task: DetectionTask, zooms: Sequence[float]
) -> list[DetectabilityCurve]:
    curves = []
    for observer in task.observers:
        for noise_dn in task.noises_dn:
            results = found[observer, noise_dn]
            slopes = [one.slopes for one in results if one.slopes is not None]
            uncertainty = None
            if len(slopes) == len(zooms):
                uncertainty = CurveUncertainty(
                    sources=task.sources, scene=[one.scene_err for one in results], slopes=slopes
                )
            for contrast_dn in task.contrasts_dn:
                # The noise does not depend on the signal: d' is proportional to the contrast.
                is_seen = observer == "changes" and bool(seen)
                values = [contrast_dn * one.value for one in results]
                low, high = (
                    [contrast_dn * getattr(one, end) for one in results] for end in ("low", "high")
                )
                curve = DetectabilityCurve(
                    model=model,
                    observer=observer,
                    noise_dn=noise_dn,
                    contrast_dn=contrast_dn,
                    signal_sigma_px=task.signal.sigma_px,
                    zoom=list(zooms),
                    dprime=values,
                    dprime_low=low,
                    dprime_high=high,
                    dprime_low_scene=low,
                    dprime_high_scene=high,
                    auc=auc_of(np.array(values)).tolist(),
                    uncertainty=uncertainty,
                    seen_sigma_px=seen["sigma_px"] if is_seen else None,
                    seen_dn=[contrast_dn * one for one in seen["peak"]] if is_seen else None,
                )
                curves.append(curve.with_sources(task.sources))
    return curves
