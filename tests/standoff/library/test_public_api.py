"""What ``import standoff`` gives: on arrays and on files, with results that a person can read."""

import inspect
import re
import subprocess
import sys
from math import erf, radians
from pathlib import Path
from types import FunctionType
from typing import Any, cast

import numpy as np
import pytest
import tifffile
from PIL import Image

import standoff
from simulation.arrays import FloatArray
from standoff.errors import ImageFileError
from tests.calibration.blob_scene import blob_photograph

SIGMA_PX = 0.7
ZOOM = 1.3
SPOT = (90, 140)  # row and column of the follow-up
PSF = standoff.GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)


def known_edge(angle_deg: float) -> FloatArray:
    """An edge of 20 and 220 DN blurred by a Gaussian of ``SIGMA_PX``: closed form."""
    y, x = np.mgrid[-48.0:48.0, -48.0:48.0]
    turn = radians(angle_deg)
    across = (x * np.cos(turn) + y * np.sin(turn)) / (SIGMA_PX * np.sqrt(2))
    noise = np.random.default_rng(int(angle_deg)).normal(0, 0.3, x.shape)
    return np.asarray(120 + 100 * np.vectorize(erf)(across) + noise)


@pytest.fixture(scope="module")
def edges() -> list[FloatArray]:
    return [known_edge(angle) for angle in (5.0, 50.0, 95.0, 140.0)]


@pytest.fixture(scope="module")
def edge_files(edges: list[FloatArray], tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("edges")
    paths = [folder / f"{number}.tif" for number in range(len(edges))]
    for path, edge in zip(paths, edges, strict=True):
        tifffile.imwrite(path, edge)
    return [str(path) for path in paths]


@pytest.fixture(scope="module")
def pair() -> tuple[FloatArray, FloatArray]:
    """A scene in closed form, and the same from 1.3 times further away with a spot of 60 DN."""
    rng = np.random.default_rng(3)
    near, far = (blob_photograph(zoom, PSF.covariance_px2, blobs=900) for zoom in (1.0, ZOOM))
    y, x = np.indices(far.shape)
    spot = 60 * np.exp(-((y - SPOT[0]) ** 2 + (x - SPOT[1]) ** 2) / (2 * 2.0**2))
    return near + rng.normal(0, 2, near.shape), far + spot + rng.normal(0, 2, far.shape)


def test_the_names_are_those_of_the_guide() -> None:
    guide = (Path(__file__).parents[3] / "docs" / "library.md").read_text("utf-8")
    for name in dir(standoff):
        assert f"{name}(" in guide or f"| `{name}`" in guide or f", `{name}`" in guide, name


def sections(function: FunctionType) -> dict[str, str]:
    """The sections of a numpydoc docstring, by title."""
    _, *found = re.split(r"^([A-Z]\w+)\n-+$", inspect.getdoc(function) or "", flags=re.MULTILINE)
    return dict(zip(found[::2], found[1::2], strict=True))


@pytest.mark.parametrize(
    "function",
    [one for name in dir(standoff) if isinstance(one := getattr(standoff, name), FunctionType)],
    ids=lambda function: function.__name__,
)
def test_a_function_says_what_it_takes_and_returns_and_shows_how(function: FunctionType) -> None:
    told, signature = sections(function), inspect.signature(function)
    lines = [line for line in told.get("Parameters", "").splitlines() if line[:1].strip()]
    assert {name for line in lines for name in line.split(", ")} == set(signature.parameters)
    assert ("Returns" in told) == (signature.return_annotation is not None)
    assert f"standoff.{function.__name__}(" in told["Examples"]


def test_importing_it_loads_nothing() -> None:
    heavy = ("numpy", "scipy", "numba", "cv2", "pydantic", "matplotlib", "skimage", "torch")
    code = f"import sys, standoff; print(*(m for m in {heavy} if m in sys.modules), end='')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == ""


def test_files_give_the_psf_of_their_arrays(edges: list[FloatArray], edge_files: list[str]) -> None:
    found, again = standoff.calibrate_psf(edges), standoff.calibrate_psf(edge_files)
    assert found.sigma_x_px == pytest.approx(SIGMA_PX, abs=0.004)  # the edges' own blur
    assert (found.sigma_x_px, found.rho) == (again.sigma_x_px, again.rho)


def test_a_photograph_may_stand_alone(edge_files: list[str]) -> None:
    found = standoff.calibrate_psf(edge_files[2])
    assert (found.sigma_x_px is None) != (found.sigma_y_px is None)
    (edge,) = standoff.measure_edges(edge_files[2])
    assert edge.sigma_px == pytest.approx(SIGMA_PX, abs=0.005)


def test_the_example_photographs_are_those_of_their_readme() -> None:
    pair = standoff.example_photographs()
    told = (pair.nearer.parent / "README.md").read_text("utf-8")
    for path in (pair.nearer, pair.further, pair.before, pair.after):
        assert path.name in told
        is_postcard = path in (pair.nearer, pair.further)
        shape = (440, 520) if is_postcard else (336, 304)
        assert standoff.read_image(path).grey_dn.shape == shape
    assert "MIT License" in (pair.nearer.parent / "LICENSE").read_text("utf-8")
    assert "Apache License" in (pair.before.parent / "LICENSE.lantern").read_text("utf-8")


def test_a_lantern_that_somebody_took_away_is_gone_and_nothing_else_has_changed() -> None:
    pair = standoff.example_photographs()
    (gone,) = standoff.find_changes(pair.before, pair.after).summary.changes
    before, after = (
        np.asarray(Image.open(path).convert("RGB"), dtype=np.int64)
        for path in (pair.before, pair.after)
    )
    y, x = np.nonzero(np.abs(before - after).max(axis=2) > 60)  # the lantern, and little else
    assert gone.what == "gone"
    assert (gone.x_px, gone.y_px) == pytest.approx((np.median(x), np.median(y)), abs=3)
    assert gone.area_px == pytest.approx(x.size, rel=0.15)
    back = standoff.find_changes(pair.after, pair.before).summary.changes
    assert [change.what for change in back] == ["new"]
    assert standoff.find_changes(pair.before, pair.before).summary.changes == ()


def test_a_psf_comes_back_from_its_file(edges: list[FloatArray], tmp_path: Path) -> None:
    found = standoff.calibrate_psf(edges)
    standoff.write_psf(tmp_path / "psf.json", found)
    again = standoff.read_psf(str(tmp_path / "psf.json"))
    assert again.sigma_x_px == found.sigma_x_px
    near = edges[0]
    by_result = standoff.zoom_out(near, 1.5, found)
    assert np.array_equal(by_result, standoff.zoom_out(near, 1.5, tmp_path / "psf.json"))


def test_a_pose_without_turn_or_tilt_is_a_zoom_out(pair: tuple[FloatArray, FloatArray]) -> None:
    scene, _ = pair
    straight = standoff.zoom_out(scene, 2.0, PSF)
    rows, cols = straight.shape
    middles = [(far - 1) / 2 for far in (cols, rows)], [(n - 1) / 2 for n in scene.shape[::-1]]
    shift = [near - 2 * far for far, near in zip(*middles, strict=True)]
    matrix = [[2.0, 0.0, shift[0]], [0.0, 2.0, shift[1]], [0.0, 0.0, 1.0]]
    posed = standoff.simulate_pose(scene, matrix, PSF, size=(cols, rows))
    inside = (slice(8, -8), slice(8, -8))
    # Both are model matched; the pose's blur comes from a table.
    assert np.abs(posed.image - straight)[inside].max() < 0.01 * np.ptp(straight)


@pytest.mark.slow
def test_a_pair_is_aligned_and_its_change_is_found(pair: tuple[FloatArray, FloatArray]) -> None:
    pose = standoff.register(*pair, PSF)
    assert pose.zoom == pytest.approx(ZOOM, abs=0.001)
    found = standoff.find_changes(*pair, PSF)
    assert found.is_change[SPOT]
    assert 5 < found.summary.changed_px < 200


def test_limits_follow_from_curves(pair: tuple[FloatArray, FloatArray]) -> None:
    scene, _ = pair
    task = standoff.DetectionTask(
        zooms=(1.0, 1.2, 1.5), noises_dn=(2.0,), models=("matched",), observers=("npw",)
    )
    curves = standoff.d_prime_curves(scene, PSF, task)
    (curve,) = curves.curves
    threshold = (curve.dprime[0] * curve.dprime[1]) ** 0.5
    limits = standoff.pose_limits(curves, threshold, focal_length_px=900.0, image_size=(780, 580))
    assert 1.0 < limits.zoom < 1.2


@pytest.mark.slow
def test_results_are_read_at_a_glance(
    edges: list[FloatArray], pair: tuple[FloatArray, FloatArray]
) -> None:
    psf = standoff.calibrate_psf(edges)
    task = standoff.DetectionTask(zooms=(1.0, 1.5), models=("matched",), observers=("npw",))
    curves = standoff.d_prime_curves(pair[0], PSF, task)
    curve = curves.curves[0]
    limits = standoff.pose_limits(
        curve, 0.99 * curve.dprime[0], focal_length_px=900.0, image_size=(780, 580)
    )
    shown: tuple[Any, ...] = (psf, curves, limits, standoff.find_changes(*pair, PSF))
    for result in shown:
        assert len(repr(result)) < 300
        assert str(result) == repr(result)
        assert result._repr_html_().startswith("<table>")
        assert result.plot().axes
    short: tuple[object, ...] = (
        standoff.register(*pair, PSF),
        standoff.measure_edges(edges[0])[0],
        standoff.simulate_pose(pair[0], np.eye(3), PSF),
        curve,
    )
    for other in short:
        assert len(repr(other)) < 300
        assert str(other) == repr(other)


@pytest.mark.parametrize("wrong", [None, 5, {"a": 1}], ids=["none", "number", "mapping"])
def test_what_is_no_image_no_psf_and_no_path_is_a_type_error(wrong: Any) -> None:
    image, listed = np.ones((40, 40)), cast(Any, [wrong])
    for call in (
        lambda: standoff.zoom_out(wrong, 2.0, PSF),
        lambda: standoff.zoom_out(image, 2.0, psf=listed),
        lambda: standoff.calibrate_psf(wrong),
        lambda: standoff.measure_edges(wrong),
        lambda: standoff.register(image, wrong),
        lambda: standoff.find_changes(wrong, image, PSF),
        lambda: standoff.read_psf(wrong),
        lambda: standoff.write_psf("psf.json", wrong),
        lambda: standoff.simulate_pose(image, wrong, PSF),
        lambda: standoff.pose_limits(wrong, 2.0, focal_length_px=900.0, image_size=(78, 58)),
        lambda: standoff.Session(wrong),
    ):
        with pytest.raises(TypeError) as refused:
            call()
        assert "\n" not in str(refused.value)
        assert "got " in str(refused.value)


def test_an_array_that_is_no_image_is_refused() -> None:
    with pytest.raises(ImageFileError):
        standoff.zoom_out(np.full((30, 30), np.nan), 2.0, PSF)
    with pytest.raises(ImageFileError):
        standoff.measure_edges(np.ones(30))
    with pytest.raises(ValueError):
        standoff.calibrate_psf([])
