"""Predicted errors of a planned capture session, and what it would take to reach wanted ones."""

import re
from collections.abc import Iterable, Mapping, Sequence
from math import isfinite
from typing import Any

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.plan import CapturePlan
from analysis.study import (
    BUILT_IN,
    UNITS,
    PlanStudy,
    StudiedPlan,
    StudyPredictions,
    Want,
    WantName,
    next_step,
    studied,
    studied_want,
)
from calibration.choices import DEFAULT_BOARD_TEXT
from calibration.geometry import CharucoBoard, GeometryCalibration
from simulation.arguments import arguments_at_fault, checked
from simulation.arrays import FloatArray
from standoff.errors import ArgumentError
from standoff.library._planned_session import (
    EdgeTemplate,
    KnownInputs,
    SoughtChange,
    pixel_levels,
    planned_edges,
)
from standoff.library.call import (
    Call,
    FilePath,
    ImageLike,
    NoiseLike,
    Progress,
    PsfLike,
    listed_images,
)

_MOST_PHOTOGRAPHS = 24
_USUAL_COUNT = 2
_FEWEST_SIDE_PX = 128


@checked
@arguments_at_fault()
def plan_study(
    plan: CapturePlan | FilePath,
    bench: BenchConfig | FilePath,
    psf: PsfLike,
    *,
    want: str | Iterable[str] = (),
    photographs: ImageLike | Iterable[ImageLike] = (),
    photograph_count: int | None = None,
    focus_scatter_px2: float | None = None,
    height_scatter_mm: float | None = None,
    noise: NoiseLike | None = None,
    geometry: GeometryCalibration | FilePath | None = None,
    edges_per_capture: int | None = None,
    edge_length_px: float | None = None,
    levels_dn: tuple[float, float] | None = None,
    board: CharucoBoard | str = DEFAULT_BOARD_TEXT,
    scene_noise_dn: float | None = None,
    contrast_dn: float | None = None,
    signal_sigma_px: float = 2.0,
    min_d_prime: float = 2.0,
    settings: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> PlanStudy:
    """Predict the errors of what a planned capture session will measure, by Fisher information.

    Nothing is captured.

    Parameters
    ----------
    plan, bench, settings
        As in ``capture_session``.
    psf
        The PSF as it is known today. The edges of a psf.json also say how many edges a capture
        shows, and of what length.
    want
        Wanted half-widths of 95 % intervals, such as ``sigma=0.5%``, ``transfer=1%``,
        ``pupil=0.5mm``, ``dprime=5%`` or ``tilt=0.3deg``.
    photographs
        Photographs of the scene, of which the middle 256 px are used; without any, built-in
        pictures take their place.
    photograph_count
        Number of photographs of the scene that are planned; by default the number given, or else 2.
    focus_scatter_px2
        Standard deviation of the PSF's variance from capture to capture; by default that of
        psf.json, or else 0.
    height_scatter_mm
        Standard deviation of the heights read back about the true ones; by default that of
        ``geometry``, or else the tolerance of a stage that is moved by hand, 0 for a motor.
    noise
        Noise of the camera, or the path of a noise.json; by default what a simulated bench states,
        or else that of the edges in psf.json.
    geometry
        Geometry of an earlier session, or the path of its geometry.json, for pupil offset, focal
        length and scatter of the heights.
    edges_per_capture, edge_length_px
        Number of edges per capture and their length in px; by default those in psf.json.
    levels_dn
        Dark and bright level of the edges, in DN.
    board
        The ChArUco board, for captures of kind ``board``.
    scene_noise_dn
        Noise of a pixel of the photographs, in DN; by default that of a capture at their mean
        level.
    contrast_dn, signal_sigma_px
        Peak in DN and width in px of the change; the peak is by default 5 % of the photographs'
        mean level.
    min_d_prime
        Threshold of d' by which the limit of the tilt is predicted.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    PlanStudy
        Predicted standard errors with their budgets, what each wanted error takes, and what to do
        next.

    Raises
    ------
    ArgumentError
        If an argument is not possible, or a photograph is too small.
    BenchConfigError, PlanError, PsfFileError
        If a file is not valid.

    Examples
    --------
    >>> study = standoff.plan_study("session.toml", "bench.toml", "psf.json", want="sigma=1%")
    >>> print(study.next_step)
    Run the plan: it is enough for everything that is wanted.
    """
    wants, layout = _parsed_wants(want), _board(board)
    call = Call("plan_study", progress, files=(plan, bench, psf, noise, geometry))
    known = KnownInputs.of(call, (plan, bench, settings), psf, noise, geometry)
    shown = _photographs(call, photographs)
    pixels = pixel_levels(known.bench, known.calibration, known.noise, levels_dn)
    template = EdgeTemplate.of(known.calibration, known.frame, edges_per_capture, edge_length_px)
    focus_px2 = known.focus_scatter_px2(focus_scatter_px2)
    asked = StudiedPlan(
        edges=planned_edges(known.entries, template, pixels.levels, known.frames, focus_px2 or 0.0),
        psf=known.psf,
        gaussian=known.gaussian,
        transfer=known.transfer,
        board=known.board(layout, pixels, known.height_scatter_mm(height_scatter_mm)),
        pupil_offset_mm=known.pupil_offset_mm,
        scene=known.scene(
            shown,
            pixels,
            SoughtChange(
                contrast_dn=contrast_dn,
                signal_sigma_px=signal_sigma_px,
                noise_dn=scene_noise_dn,
                min_d_prime=min_d_prime,
                planned_count=photograph_count or len(shown) or _USUAL_COUNT,
            ),
        ),
    )
    assumptions = [*pixels.assumptions, template.assumption, *known.exposure_assumptions]
    if focus_px2 is None:
        assumptions.append(_FOCUS_UNKNOWN)
        call.note(_FOCUS_UNKNOWN)
    return _document(call, known, asked, wants, [*assumptions, *_told(asked, shown)])


_FOCUS_UNKNOWN = (
    "the focus is taken as the same in every capture: state focus_scatter_px2, or give a psf.json "
    "that has it"
)


@checked
def write_study(path: FilePath, study: PlanStudy) -> None:
    """Write a study.json, whole or not at all.

    Parameters
    ----------
    path
        Path of the file to write.
    study
        As ``plan_study`` returns it.

    Raises
    ------
    ResultsFileError
        If the file cannot be written.

    Examples
    --------
    >>> study = standoff.plan_study("session.toml", "bench.toml", "psf.json")
    >>> standoff.write_study("study.json", study)
    """
    study.write(path)


def _board(board: CharucoBoard | str) -> CharucoBoard:
    try:
        return board if isinstance(board, CharucoBoard) else CharucoBoard.from_text(board)
    except ValueError as error:
        raise ArgumentError(str(error), argument="board") from error


def _photographs(call: Call, photographs: ImageLike | Iterable[ImageLike]) -> list[FloatArray]:
    """Grey levels of the first photographs."""
    if isinstance(photographs, list | tuple) and not photographs:
        return []
    listed = listed_images(photographs, "photographs")
    if len(listed) > _MOST_PHOTOGRAPHS:
        call.note(f"only the first {_MOST_PHOTOGRAPHS} of {len(listed)} photographs are used")
    shown = []
    for number, image in enumerate(listed[:_MOST_PHOTOGRAPHS]):
        name = str(image) if isinstance(image, str) else f"photographs[{number}]"
        grey = call.photograph(image, name).grey_dn
        if min(grey.shape) < _FEWEST_SIDE_PX:
            raise ArgumentError(
                f"{name}: {grey.shape[1]} x {grey.shape[0]} px are too few; "
                f"{_FEWEST_SIDE_PX} a side are needed"
            )
        shown.append(np.asarray(grey, dtype=np.float64))
    return shown


def _told(asked: StudiedPlan, shown: Sequence[FloatArray]) -> list[str]:
    """What is taken for granted of scene, change and heights."""
    scene = asked.scene
    told = [
        f"d' is that of a Gaussian change of {scene.contrast_dn:.4g} DN and "
        f"{scene.signal_sigma_px:g} px in noise of {scene.noise_dn:.3g} DN, by the ideal linear "
        f"observer; the tilt limit keeps it at {scene.min_d_prime:g}"
    ]
    if not shown:
        told.append(f"no photographs: the scene is {BUILT_IN}")
    elif len(shown) < 16:
        told.append(f"{len(shown)} photographs: parts of them stand in for further photographs")
    if asked.board is not None:
        told.append(
            "the board lies centred under the camera, and heights scatter by "
            f"{asked.board.height_scatter_mm:g} mm"
        )
    return told


def _document(
    call: Call,
    known: KnownInputs,
    asked: StudiedPlan,
    wants: Sequence[Want],
    assumptions: Sequence[str],
) -> PlanStudy:
    found: StudyPredictions = studied(asked)
    edges = 0 if asked.edges is None else len(asked.edges.edges)
    size = known.size(edges, asked.scene.planned_count)
    answers = [studied_want(one, found.predictions, size) for one in wants]
    return PlanStudy(
        predicted=tuple(one.document() for one in found.predictions),
        wants=tuple(answers),
        next_step=next_step(answers, found.predictions, size),
        d_ln_dprime_d_ln_sigma=found.sensitivities.by_log_sigma,
        d_ln_dprime_d_ln_noise=found.sensitivities.by_log_noise,
        captures=len(known.entries),
        frames_per_capture=known.frames,
        edges=edges,
        photographs=asked.scene.planned_count,
        assumptions=tuple(assumptions),
        notes=call.notes,
        provenance=call.provenance(),
    )


_WRITTEN = re.compile(r"\s*([a-z]+)\s*=\s*([0-9.eE+-]+)\s*(%|[a-z]*)\s*")


def _parsed_wants(texts: Iterable[str]) -> tuple[Want, ...]:
    """Return the wants; each is half the width of a 95 % interval."""
    listed = [texts] if isinstance(texts, str) else list(texts)
    return tuple(_parsed(text) for text in listed)


def _parsed(text: str) -> Want:
    found = _WRITTEN.fullmatch(text)
    names: dict[str, WantName] = {name: name for name in UNITS}
    if found is None or found[1] not in names:
        forms = ", ".join(f"{name}=N{unit}" for name, unit in UNITS.items())
        raise ArgumentError(f"expected one of {forms}, got {text!r}", argument="want")
    name = names[found[1]]
    unit = UNITS[name]
    if found[3] != unit:
        raise ArgumentError(f"{text!r}: {name} must be given in {unit}", argument="want")
    try:
        number = float(found[2])
    except ValueError as error:
        raise ArgumentError(f"{text!r}: {found[2]} is not a number", argument="want") from error
    if not (isfinite(number) and number > 0):
        raise ArgumentError(f"{text!r}: expected a number above 0", argument="want")
    return Want(name=name, half_width=number / 100 if unit == "%" else number)
