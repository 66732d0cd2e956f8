"""Closed forms, invariants and a Monte Carlo that shares no code with the analysis."""

import os
from collections.abc import Callable
from dataclasses import replace
from math import exp, hypot, pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates
from skimage import data

from analysis.choices import OBSERVERS
from analysis.detectability import (
    ArtefactTiles,
    DetectionTask,
    GaussianSignal,
    LocalChange,
    PatchSignal,
    Scenario,
    WindowCovariance,
    auc_of,
    compared_pair,
    curves_of_images,
    d_primes,
    local_changes,
    observer_templates,
    scene_artefact,
)
from analysis.detectability._artefact import DenseCovariance, artefact_tiles
from analysis.detectability._scenario import signal_offsets_px
from simulation import GaussianPsf, Model
from simulation.arrays import FloatArray
from tests.analysis.detectability_trials import run_trials

SIGMA_PX = 0.9
PSF = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)
SPOT = GaussianSignal(sigma_px=2.0)
N = 15
SCENARIO = Scenario(psf=PSF, window_px=N)
NO_ARTEFACT = ArtefactTiles(
    products_dn2=np.zeros((1, 2 * N - 1, 2 * N - 1)), pixels=np.array([900.0])
)


def texture(seed: int = 0, shape: tuple[int, int] = (180, 220)) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.asarray(120 + 60 * gaussian_filter(rng.standard_normal(shape), 1.2))


def changes(zoom: float, model: Model = "matched", positions: int = 2) -> tuple[LocalChange, ...]:
    return local_changes(SPOT, replace(SCENARIO, positions=positions), model, zoom)


def test_at_equal_distances_all_observers_reach_the_closed_form() -> None:
    # Gaussian on c' of width sqrt(2^2 + (4 - 1) S^2) / 2 and the volume of the one on c:
    # |s| = C' sigma' sqrt(pi); two independent images give noise sigma sqrt(2).
    landed_px = sqrt(4 + 3 * SIGMA_PX**2) / 2
    landed_dn = 12 * 2.0**2 / (4 * landed_px**2)
    expected = landed_dn * landed_px * sqrt(pi / 2) / 3.0
    for result in d_primes(changes(1.0), NO_ARTEFACT, 3.0).values():
        assert 12 * result.value == pytest.approx(expected, rel=1e-3)  # the blur's cut-off tails
        assert result.low == pytest.approx(result.high, rel=1e-12)


def test_a_flat_scene_and_equal_distances_have_no_artefact() -> None:
    flat = np.full((160, 180), 77.0)
    for zoom in (1.0, 1.7):
        assert np.abs(compared_pair(flat.shape, PSF, "matched", zoom).artefact_of(flat)).max() < (
            1e-9
        )
    scene = texture()
    assert np.abs(compared_pair(scene.shape, PSF, "paper", 1.0).artefact_of(scene)).max() < 1e-9


def test_the_border_of_an_image_is_no_artefact() -> None:
    # Smooth shading: cut off sharply, its border would leak into all frequencies.
    rows = np.linspace(-1, 1, 120)
    field = np.outer(100 * rows, np.ones(120))
    template = np.zeros((N, N))
    template[N // 2, N // 2 - 1 : N // 2 + 2] = template[N // 2 - 1 : N // 2 + 2, N // 2] = -1.0
    template[N // 2, N // 2] = 4.0  # blind to shading
    tiles = artefact_tiles(field, N, 1)
    response = float(tiles.template_sums(template).sum() / tiles.pixels.sum())
    padded = np.pad(field, 1)
    sharp = float(
        np.mean(
            (
                4 * field
                - padded[2:, 1:-1]
                - padded[:-2, 1:-1]
                - padded[1:-1, 2:]
                - padded[1:-1, :-2]
            )
            ** 2
        )
    )
    assert sharp > 20 * response


def test_without_artefact_white_noise_leaves_hotelling_and_npw_equal_at_zoom_1() -> None:
    for change in changes(1.0):
        # U is the identity.
        noise = WindowCovariance(1.0, change.up_y, change.up_x, np.zeros((2 * N - 1, 2 * N - 1)))
        np.testing.assert_allclose(noise.dense(), 2 * np.eye(N * N), atol=1e-12)


@pytest.mark.parametrize("model", ["bicubic", "paper", "matched"])
def test_no_linear_observer_beats_hotelling_and_d_prime_falls_with_zoom(model: Model) -> None:
    scene = texture()
    last = np.inf
    for zoom in (1.0, 1.3, 1.8, 2.5):
        artefact = scene_artefact(scene, SCENARIO, model, zoom, 2)
        found = d_primes(changes(zoom, model), artefact, 2.0)
        assert found["hotelling"].value >= found["cho"].value * (1 - 1e-9)
        assert found["hotelling"].value >= found["npw"].value * (1 - 1e-9)
        assert found["hotelling"].value < last
        last = found["hotelling"].value
        for one in found.values():
            assert one.low <= one.value * (1 + 0.02)
            assert one.value <= one.high * (1 + 0.02)


@pytest.mark.slow
@settings(max_examples=6)
@given(contrast=st.floats(0.1, 50.0), noise=st.floats(0.5, 20.0))
def test_d_prime_is_proportional_to_contrast_and_auc_lies_between_half_and_one(
    contrast: float, noise: float
) -> None:
    task = DetectionTask(
        signal=SPOT,
        contrasts_dn=(contrast, 2 * contrast),
        noises_dn=(noise,),
        zooms=(1.5,),
        models=("matched",),
        window_px=N,
    )
    curves = curves_of_images([texture()], PSF, task).curves
    for observer in OBSERVERS:
        one, two = (c for c in curves if c.observer == observer)
        assert two.dprime[0] == pytest.approx(2 * one.dprime[0], rel=1e-12)
        assert 0.5 <= one.auc[0] <= 1.0


@settings(max_examples=6)
@given(factor=st.floats(0.1, 10.0))
def test_scaling_all_levels_changes_nothing(factor: float) -> None:
    scene = texture()
    [plain] = [scene_artefact(scene, SCENARIO, "paper", 1.4, 1)]
    scaled = scene_artefact(factor * scene, SCENARIO, "paper", 1.4, 1)
    a = d_primes(changes(1.4, "paper", 1), plain, 2.0)
    b = d_primes(changes(1.4, "paper", 1), scaled, 2.0 * factor)
    for observer in OBSERVERS:
        assert factor * b[observer].value == pytest.approx(a[observer].value, rel=1e-6)


def test_the_order_of_the_images_does_not_matter() -> None:
    parts = [scene_artefact(texture(k), SCENARIO, "matched", 1.5, 2) for k in range(3)]
    a = d_primes(changes(1.5), ArtefactTiles.joined(parts), 2.0)
    b = d_primes(changes(1.5), ArtefactTiles.joined(parts[::-1]), 2.0)
    for observer in OBSERVERS:
        assert a[observer].value == pytest.approx(b[observer].value, rel=1e-9)


NOWHERE = np.zeros((3, 1))
"""Rows of an alignment that takes nothing."""


@settings(max_examples=10)
@given(
    seed=st.integers(0, 1000), noise_dn2=st.floats(0.01, 100.0), correlation_px=st.floats(0.2, 4.0)
)
def test_the_covariance_is_inverted_as_the_matrix_written_out_is(
    seed: int, noise_dn2: float, correlation_px: float
) -> None:
    rng = np.random.default_rng(seed)
    artefact = artefact_tiles(
        gaussian_filter(rng.standard_normal((60, 70)), correlation_px), 11, 1
    ).autocovariance_dn2
    up_y, up_x = rng.standard_normal((2, 11, 8)) / 3
    covariance = WindowCovariance(noise_dn2, up_y, up_x, artefact)
    matrix = covariance.dense()
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * matrix.max())
    signal = rng.standard_normal((11, 11))
    np.testing.assert_allclose(covariance.times(covariance.solved(signal)), signal, atol=1e-7)
    expected = DenseCovariance(matrix).solved(signal)
    np.testing.assert_allclose(
        covariance.solved(signal), expected, atol=1e-6 * np.abs(expected).max()
    )


def test_the_noise_is_that_of_both_images() -> None:
    # sigma^2 (I + U U^T), U the Kronecker product of what happens along each axis.
    rng = np.random.default_rng(2)
    up_y, up_x = rng.standard_normal((2, 4, 6))
    found = WindowCovariance(2.5, up_y, up_x, np.zeros((7, 7))).dense()
    up = np.kron(up_y, up_x)
    np.testing.assert_allclose(found, 2.5 * (np.eye(16) + up @ up.T), atol=1e-12)


def test_the_window_covariance_is_that_of_all_windows() -> None:
    # Worked out by cutting every window of the image, padded by zeros; it fades over 1 px,
    # to (1 - cos(pi / 2)) / 2 at the border, and each lag counts by what the fading leaves of it.
    rng = np.random.default_rng(3)
    field = rng.standard_normal((9, 11))
    tiles = artefact_tiles(field, 3, 2)
    fading = np.outer(*(np.pad(np.ones(n - 2), 1, constant_values=0.5) for n in field.shape))
    padded = np.pad(fading * (field - field.mean()), 2)
    windows, faded = (
        np.lib.stride_tricks.sliding_window_view(image, (3, 3)).reshape(-1, 9)
        for image in (padded, np.pad(fading, 2))
    )
    covariance = (windows.T @ windows) / (faded.T @ faded)
    np.testing.assert_allclose(
        WindowCovariance(1.0, NOWHERE, NOWHERE, tiles.autocovariance_dn2).dense() - np.eye(9),
        covariance,
        atol=1e-12,
    )
    template = rng.standard_normal((3, 3))
    assert tiles.template_sums(template).sum() == pytest.approx(
        float(template.ravel() @ covariance @ template.ravel() * np.sum(fading**2))
    )


def test_a_row_of_pixels_is_not_taken_for_a_column() -> None:
    field = np.tile(np.sin(np.arange(40.0)), (30, 1))  # changes along x alone
    lags = artefact_tiles(field, 5, 1).autocovariance_dn2
    assert lags[5, 4] == pytest.approx(lags[4, 4], rel=0.05)  # one row on, the border apart
    assert lags[4, 5] == pytest.approx(lags[4, 4] * np.cos(1.0), rel=0.1)


def test_auc_of_no_and_of_sure_detection() -> None:
    assert auc_of(0.0) == 0.5
    assert auc_of(sqrt(2.0)) == pytest.approx(0.841345, abs=1e-6)  # Phi(1)
    assert auc_of(40.0) == 1.0


def test_signals_lie_where_they_were_asked_for() -> None:
    spot = SPOT.image(31, (3, -4))
    assert spot[18, 11] == spot.max() == 1.0
    assert spot[18, 12] == pytest.approx(exp(-1 / 8))
    patch = PatchSignal(levels_dn=np.pad(np.full((2, 4), -30.0), 2, constant_values=10.0))
    placed = patch.image(31, (3, -4))
    assert placed.min() == -1.0
    assert placed.max() == 0.0
    rows, cols = np.nonzero(placed)
    assert (rows.mean(), cols.mean()) == (17.5, 10.5)
    assert len(set(signal_offsets_px(6, 3.0))) == 6
    with pytest.raises(ValueError):
        PatchSignal(levels_dn=np.ones((5, 5)))


WIDE = GaussianSignal(sigma_px=9.0)


@pytest.mark.parametrize(
    "call",
    [
        pytest.param(lambda: d_primes(changes(1.0), NO_ARTEFACT, 0.0), id="no noise"),
        pytest.param(lambda: Scenario(psf=PSF, window_px=20), id="an even window"),
        pytest.param(lambda: Scenario(psf=PSF, window_px=3), id="a window of 3 px"),
        pytest.param(lambda: Scenario(psf=PSF, reference_zoom=0.5), id="a nearer reference"),
        pytest.param(lambda: Scenario(psf=PSF, positions=0), id="no position"),
        pytest.param(lambda: DetectionTask(zooms=(1.5, 1.0)), id="falling zooms"),
        pytest.param(lambda: DetectionTask(zooms=(0.9, 1.0)), id="a zoom below 1"),
        pytest.param(lambda: GaussianSignal(sigma_px=0.0), id="a spot without width"),
        pytest.param(lambda: PatchSignal(levels_dn=np.eye(2)), id="a patch of 2 px"),
        pytest.param(
            lambda: PatchSignal(levels_dn=np.diag([1.0, np.nan, 1.0])), id="a patch of NaN"
        ),
        pytest.param(
            lambda: scene_artefact(np.ones((40, 40)), SCENARIO, "matched", 2.0), id="a small image"
        ),
        pytest.param(lambda: local_changes(WIDE, SCENARIO, "matched", 1.5), id="a wide change"),
        pytest.param(lambda: curves_of_images([], PSF), id="no image"),
    ],
)
def test_what_cannot_be_answered_is_refused(call: Callable[[], object]) -> None:
    with pytest.raises(ValueError):
        call()


def test_curves_of_photographs_are_the_document_and_print_in_a_line() -> None:
    task = DetectionTask(zooms=(1.0, 1.5), models=("matched",), noises_dn=(2.0,), window_px=N)
    found = curves_of_images([texture(), texture(1)], PSF, task)
    assert (found.images, found.window_px, found.signal) == (2, N, "gaussian")
    assert repr(found) == (
        "<3 curves of d', zoom 1 to 1.5: matched npw, matched hotelling, matched cho>"
    )
    [npw, *_] = found.curves
    assert repr(npw).startswith("<d' of matched, npw, noise 2 DN, contrast 12 DN: ")
    # At equal distances the scene does not matter, nor, by 1e-3, the position on the pixels.
    flat = d_primes(changes(1.0), NO_ARTEFACT, 2.0)["npw"].value
    assert npw.dprime[0] == pytest.approx(12 * flat, rel=1e-3)


def keys_cubic_upscaled(
    image: FloatArray, places_y: FloatArray, places_x: FloatArray
) -> FloatArray:
    """Keys' cubic written out: the alignment, independent of the analysis."""

    def matrix(places: FloatArray, size: int) -> FloatArray:
        x = np.abs(places[:, None] - np.arange(size))
        near = 1.5 * x**3 - 2.5 * x**2 + 1
        far = -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
        return np.where(x < 1, near, np.where(x < 2, far, 0.0))

    rows, cols = image.shape[-2:]
    return np.asarray(matrix(places_y, rows) @ image @ matrix(places_x, cols).T)


def test_on_a_flat_scene_a_monte_carlo_of_scipy_alone_agrees() -> None:
    """`matched` is a blur by Sigma (z^2 - 1) and point samples: gaussian_filter, map_coordinates.

    3 standard errors are allowed; at 4000 trials one is about 2 %.
    """
    zoom, noise_dn, contrast_dn, side, trials = 1.5, 3.0, 12.0, 181, 4000
    rng = np.random.default_rng(11)
    place: FloatArray = np.arange(float(side)) - side // 2
    spot: FloatArray = contrast_dn * np.exp(
        -0.5 * (place[:, None] ** 2 + place[None, :] ** 2) / 4.0
    )
    grids = []
    for total in (2.0, 2.0 * zoom):
        count = int(side / total)
        grids.append((np.arange(count) - (count - 1) / 2) * total + (side - 1) / 2)
    near, far = grids
    blurred: FloatArray = gaussian_filter(spot, SIGMA_PX * sqrt((2 * zoom) ** 2 - 1), truncate=6)
    followup: FloatArray = map_coordinates(blurred, np.meshgrid(far, far, indexing="ij"), order=3)
    middle = len(near) // 2
    window = near[middle - N // 2 : middle + N // 2 + 1]
    places: FloatArray = (window - far[0]) / (2 * zoom)
    signal = keys_cubic_upscaled(followup, places, places)
    # Pixels of the follow-up within the cubic's reach of the window.
    first, last = int(places[0]) - 3, int(places[-1]) + 4
    reach = places - first
    up = keys_cubic_upscaled(np.eye(last - first), reach, np.arange(float(last - first)))
    covariance = noise_dn**2 * (np.eye(N * N) + np.kron(up @ up.T, up @ up.T))
    templates = observer_templates(signal, DenseCovariance(covariance), OBSERVERS)
    far_noise = noise_dn * rng.standard_normal((2 * trials, last - first, last - first))
    near_noise = noise_dn * rng.standard_normal((2 * trials, N, N))
    noise = keys_cubic_upscaled(far_noise, reach, reach) - near_noise
    analytic = d_primes(changes(zoom, positions=4), NO_ARTEFACT, noise_dn)
    for name, template in templates.items():
        decisions = np.sum(noise * template, axis=(1, 2))
        absent, present = decisions[:trials], decisions[trials:] + np.sum(signal * template)
        spread = sqrt((absent.var(ddof=1) + present.var(ddof=1)) / 2)
        d_prime = float(present.mean() - absent.mean()) / spread
        error = sqrt(2 / trials + d_prime**2 / (4 * trials))
        assert abs(contrast_dn * analytic[name].value - d_prime) < 3 * error, name


def assert_trials_agree(
    scenes: list[FloatArray], model: Model, zoom: float, tiles_per_side: int, trials: int
) -> None:
    """Hold the analytic d' of all observers to counted decisions on the same scenes."""
    rng = np.random.default_rng(5)
    noise_dn, contrast_dn = 2.0, 12.0
    scenario = Scenario(psf=PSF, positions=2)
    artefact = ArtefactTiles.joined(
        [scene_artefact(scene, scenario, model, zoom, tiles_per_side) for scene in scenes]
    )
    images = [
        compared_pair((scene.shape[0], scene.shape[1]), PSF, model, zoom).artefact_of(scene)
        for scene in scenes
    ]
    local = local_changes(SPOT, scenario, model, zoom)
    analytic = d_primes(local, artefact, noise_dn)
    for change in local:
        covariance = WindowCovariance(
            noise_dn**2, change.up_y, change.up_x, artefact.autocovariance_dn2
        )
        templates = observer_templates(change.signal, covariance, OBSERVERS)
        drawn = run_trials(
            change,
            list(templates.values()),
            images,
            contrast_dn=contrast_dn,
            noise_dn=noise_dn,
            trials=trials,
            rng=rng,
        )
        for name, result in zip(OBSERVERS, drawn, strict=True):
            one = analytic[name]
            # 3 errors of the trials and those of the positions that the analysis averages over.
            spread = contrast_dn * (one.high - one.low) / 4
            allowed = 3 * hypot(result.d_prime_err, spread)
            assert abs(result.d_prime - contrast_dn * one.value) < allowed, name
            assert 0.5 <= result.auc <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("model", ["bicubic", "matched"])
def test_on_textures_the_trials_agree_for_all_observers(model: Model) -> None:
    photographs: list[NDArray[np.uint8]] = [data.gravel(), data.brick()]  # type: ignore[no-untyped-call]
    scenes = [one[:300, :400].astype(np.float64) for one in photographs]
    assert_trials_agree(scenes, model, 1.5, 3, 1200)


REAL_DATA = os.environ.get("STANDOFF_REAL_DATA")


@pytest.mark.slow
@pytest.mark.skipif(REAL_DATA is None, reason="STANDOFF_REAL_DATA is not set")
@pytest.mark.parametrize("model", ["bicubic", "paper", "matched"])
def test_on_lesion_images_the_trials_agree_for_all_observers(model: Model) -> None:
    assert REAL_DATA is not None
    paths = sorted(Path(REAL_DATA, "lesions").glob("*.jpg"))
    assert paths, f"{REAL_DATA} has no lesions/*.jpg"
    scenes = [np.asarray(Image.open(path).convert("L"), dtype=np.float64) for path in paths]
    assert_trials_agree(scenes, model, 1.5, 2, 1500)
