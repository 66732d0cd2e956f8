"""Wrong values for every argument of everything that is public: refused by name, or harmless."""

import inspect
import random
import warnings
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import standoff
from scripts.library_reference import TYPES
from simulation.arguments._errors import RANGES
from standoff.errors import REPORTED_ERRORS, ArgumentError

CALLS = 2500
GONE = "gone"
"""No file and no folder: where nothing refuses a wrong value before, this ends the call."""

_RNG = np.random.default_rng(1)
SCENE = _RNG.normal(500, 60, (64, 64))
PSF = standoff.GaussianPsf(sigma_px=0.7)
POSE = np.array([[1.2, 0.0, 3.0], [0.0, 1.2, 2.0], [0.0, 0.0, 1.0]])
TASK = standoff.DetectionTask(
    zooms=(1.0,),
    models=("matched",),
    observers=("npw",),
    noises_dn=(2.0,),
    window_px=9,
    reference_zoom=1.0,
    signal=standoff.Spot(sigma_px=0.5),
)

MADE_BY_HAND: dict[str, dict[str, object]] = {
    "CaptureNoise": {"gain_e_per_dn": 5.0, "read_noise_e": 12.0, "black_level_dn": 64.0},
    "CharucoBoard": {"columns": 5, "rows": 4, "square_mm": 10.0, "marker_mm": 7.0},
    "ErrorSources": {},
    "Homography": {"matrix": np.eye(3), "size": (4, 3)},
    "SceneDepth": {"depth": np.full((64, 64), 3.0)},
    "Region": {"x_px": 0, "y_px": 0, "width_px": 9, "height_px": 9},
}
"""Types of arguments that have no function to make them."""

SOUND: dict[str, dict[str, object]] = {
    "Bench": {"bench": GONE},
    "CaptureOptions": {},
    "ChangePairsTask": {},
    "CurveChoice": {},
    "DetectionLimitOptions": {},
    "DetectionTask": {},
    "EvaluationTask": {},
    "FeatureMatches": {"followup_px": np.ones((5, 2)), "reference_px": np.ones((5, 2))},
    "GaussianPsf": {"sigma_x_px": 0.7, "sigma_y_px": 0.7},
    "PoseWatch": {"reference": SCENE, "curve": GONE, "min_d_prime": 2.0},
    "RegistrationHints": {},
    "Session": {"path": "session"},
    "Spot": {},
    "SweepOptions": {},
    "TabulatedPsf": {"table": np.hypot(*np.mgrid[:4, -3:4]) < 2, "step_cy_per_px": 0.2}
    | {"has_pixel": True},
    "TabulatedPsf.from_kernel": {"kernel": np.hypot(*np.mgrid[-4:5, -4:5]) < 3},
    "TabulatedPsf.from_mtf": {"freq_cy_per_px": (0.0, 0.2, 0.6), "mtf": (1.0, 0.5, 0.1)},
    "TabulatedPsf.from_otf": {"otf": lambda fx, fy: np.exp(-9 * (fx**2 + fy**2))},
    "TabulatedPsf.from_pupil": {"pupil": np.ones((9, 9)), "cut_off_period_px": 0.4},
    "TabulatedPsf.from_zernike": {"waves": {4: 0.1}, "cut_off_period_px": 0.4},
    "TrainingOptions": {},
    "UncertaintyOptions": {},
    "add_note": {"session": GONE, "text": "x"},
    "alignment_hints": {"zoom": 1.2},
    "calibrate_geometry": {"session": GONE},
    "calibrate_psf": {"images": SCENE},
    "capture_session": {"plan": GONE, "bench": "bench.toml", "out": "o"},
    "change_pairs": {"photographs": GONE, "out": "o", "psf": PSF},
    "compare_psfs": {"first": "psf.json", "second": "psf.json"},
    "correct_height": {"session": GONE, "indices": [1], "height_mm": 3.0, "reason": "x"},
    "d_prime_curves": {"images": [SCENE], "psf": PSF, "task": TASK},
    "evaluate": {"detector": "gone:x", "photographs": GONE, "psf": PSF},
    "example_photographs": {},
    "exclude_capture": {"session": GONE, "index": 1, "reason": "x"},
    "export_session": {"session": GONE, "out": "o.tif", "format": "ome-tiff"},
    "find_cameras": {},
    "find_changes": {"reference": SCENE[:40, :40], "followup": GONE},
    "find_changes_of_series": {"reference": GONE, "followups": GONE, "out": "o"},
    "find_focus": {"bench": GONE},
    "import_photographs": {"images": [GONE], "out": "o", "kind": "texture", "height_mm": 1.0},
    "include_capture": {"session": GONE, "index": 1, "reason": "x"},
    "judge_homography": {"homography": POSE, "curve": "curves.json", "min_d_prime": 2.0}
    | {"size": (64, 64)},
    "judge_pose": {"reference": SCENE, "followup": GONE, "curve": GONE, "min_d_prime": 2.0},
    "judge_poses": {"reference": GONE, "followups": GONE, "out": "o", "curve": GONE}
    | {"min_d_prime": 2.0},
    "list_sessions": {"folder": GONE},
    "make_benchmark": {"out": "bench.toml/o"},
    "measure_curves": {"images": GONE, "state": "o", "psf": PSF},
    "measure_edges": {"image": SCENE},
    "measure_lens": {"images": [SCENE]},
    "measure_noise": {"darks": [SCENE], "flats": [SCENE]},
    "patch_of": {"path": "crack.png"},
    "plan_study": {"plan": GONE, "bench": "bench.toml", "psf": PSF},
    "pose_limits": {"curve": GONE, "min_d_prime": 2.0, "focal_length_px": 500.0}
    | {"image_size": (64, 64)},
    "preview_plan": {"plan": "plan.toml", "bench": "bench.toml"},
    "psf_history": {"files": "psf.json"},
    "reading": {},
    "register": {"reference": SCENE, "followup": GONE},
    "score_benchmark": {"results": GONE, "data": GONE},
    "set_aside_files": {"session": GONE, "reason": "x"},
    "show_session": {"session": GONE},
    "simulate": {"image": SCENE, "zoom": 1.5, "psf": PSF},
    "simulate_pose": {"image": SCENE, "homography": POSE, "psf": PSF, "size": (20, 20)},
    "train_detector": {"pairs": []},
    "training_pairs": {"images": GONE, "out": "o", "psf": PSF, "zoom": 2.0},
    "validate": {"session": GONE, "psf": "psf.json", "out": "o"},
    "verify_session": {"session": GONE},
    "watch_focus": {"bench": GONE},
    **MADE_BY_HAND,
    **{name: {"path": GONE} for name in dir(standoff) if name.startswith(("read_", "load_"))},
    "read_change_pairs": {"folder": GONE},
    "read_image": {"path": "before.tif"},
    "read_psf": {"path": "psf.json"},
    "write_curves": {"path": "o/c.json", "curves": None},
    "write_homography": {"path": "o/h.json", "homography": None},
    "write_edge_table": {"path": "o/e.csv", "psf": None},
    "write_geometry": {"path": "o/g.json", "geometry": None},
    "write_lens": {"path": "o/l.json", "lens": None},
    "write_noise": {"path": "o/n.json", "noise": None},
    "write_psf": {"path": "o/p.json", "psf": None},
    "write_report": {"session": GONE},
    "write_study": {"path": "o/s.json", "study": None},
    "zoom_out": {"image": SCENE, "zoom": 1.5, "psf": PSF},
}
"""Arguments that take little time, of every public function and type."""

NOT_CALLED = {"ArgumentError", "Progress"} | (set(TYPES) - MADE_BY_HAND.keys())
"""What is caught, what is a protocol, and results, which functions make."""


class Odd:
    """Of no use anywhere."""


WRONG: list[Any] = [
    *(None, True, 0, -1, 2.5, 0.00345, 1e300, float("inf"), float("nan"), 10**400, 1j),
    *("", "mesured", "\0", "2", "before.tif", b"x", Path("missing"), np.datetime64("2020-01-01")),
    *([], {}, (), [None], ["a"], (1, 2, 3, 4, 5), (-1, 2), (10**9, 10**9), {1, 2}),
    *(np.array([1.0, 2.0, 3.0]), np.ma.masked, np.ones((2, 3, 4, 5)), np.full((64, 64), np.nan)),
    *(np.zeros((3, 3)), -np.eye(3), np.diag([-1.0, 1.0, 1.0]), np.array(["a"])),
    *(Odd(), lambda: 0, int, standoff.CaptureOptions()),
]


def parameters(name: str) -> list[str]:
    """The names of what a public function or type takes."""
    return list(inspect.signature(attrgetter(name)(standoff)).parameters)


def every_case() -> Iterator[tuple[str, str, int]]:
    for name in SOUND:
        for parameter in parameters(name):
            for number in range(len(WRONG)):
                yield name, parameter, number


def test_all_that_is_public_is_called() -> None:
    named = {name for name in SOUND if "." not in name}
    assert named | NOT_CALLED == set(dir(standoff)) - {"__version__"}


@pytest.mark.slow
def test_wrong_values_are_refused_in_one_line_or_do_no_harm(
    files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    cases = list(every_case())
    drawn = random.Random(20)
    picked = drawn.sample(cases, CALLS)
    seldom = {name for name in SOUND if parameters(name)} - {case[0] for case in picked}
    picked += [drawn.choice([case for case in cases if case[0] == name]) for name in sorted(seldom)]
    assert {case[0] for case in picked} == {name for name in SOUND if parameters(name)}
    wrong = [(case, fault) for case in picked if (fault := fault_of(*case)) is not None]
    assert not wrong, "\n".join(f"{case}: {fault}" for case, fault in wrong)


def fault_of(name: str, parameter: str, number: int) -> str | None:
    """What is wrong with how a call ends; None if it refuses in a line, or gives something."""
    given = SOUND[name] | {parameter: WRONG[number]}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            attrgetter(name)(standoff)(**given)
    except (ArgumentError, *REPORTED_ERRORS) as error:
        said = str(error)
        return None if said and "\n" not in said else f"not one line: {said!r}"
    except Exception as error:  # noqa: BLE001 - whatever reaches a user is the point
        return f"{WRONG[number]!r:.40} gives {type(error).__name__}: {error!s:.200}"
    return None


@pytest.mark.parametrize(
    ("name", "wrong", "argument"),
    [
        ("simulate", {"transfer": "mesured"}, "transfer"),
        ("simulate", {"sampler": "foo"}, "sampler"),
        ("simulate", {"model": "macthed"}, "model"),
        ("zoom_out", {"model": "macthed"}, "model"),
        ("simulate", {"steps": 0}, "steps"),
        ("simulate", {"threads": 0}, "threads"),
        ("validate", {"models": ("macthed",)}, "models"),
        ("judge_pose", {"criterion": "all"}, "criterion"),
        ("judge_homography", {"criterion": "all"}, "criterion"),
        ("judge_homography", {"min_d_prime": 0}, "min_d_prime"),
        ("pose_limits", {"min_d_prime": -1}, "min_d_prime"),
        ("PoseWatch", {"min_d_prime": float("nan")}, "min_d_prime"),
        ("calibrate_psf", {"pixel_pitch_um": -1}, "pixel_pitch_um"),
        ("calibrate_psf", {"pixel_pitch_um": 0}, "pixel_pitch_um"),
        ("calibrate_psf", {"pixel_pitch_um": float("inf")}, "pixel_pitch_um"),
        ("calibrate_psf", {"pixel_pitch_um": 0.00345}, "pixel_pitch_um"),
        ("calibrate_psf", {"method": "all-angels"}, "method"),
        ("calibrate_psf", {"region": "center"}, "region"),
        ("find_changes", {"false_alarms": 0}, "false_alarms"),
        ("find_changes", {"false_discovery_rate": 1.5}, "false_discovery_rate"),
        ("DetectionTask", {"noises_dn": (-2,)}, "noises_dn"),
        ("DetectionTask", {"noises_dn": (0,)}, "noises_dn"),
        ("DetectionTask", {"models": ("macthed",)}, "models"),
        ("DetectionTask", {"window_px": 32}, "window_px"),
        ("DetectionTask", {"seed": -1}, "seed"),
        ("EvaluationTask", {"noises_dn": (-2,)}, "noises_dn"),
        ("ChangePairsTask", {"changes": "all"}, "changes"),
        ("ChangePairsTask", {"zooms": (2.0, 1.0)}, "zooms"),
        ("CurveChoice", {"observer": "hoteling"}, "observer"),
        ("CaptureOptions", {"seed": -1}, "seed"),
        ("SweepOptions", {"part": (3, 2)}, "part"),
        ("GaussianPsf", {"sigma_x_px": -0.7}, "sigma_x_px"),
        ("RegistrationHints", {"matrix": np.zeros((3, 3))}, "matrix"),
        ("FeatureMatches", {"reference_px": np.ones((4, 2))}, "followup_px"),
        ("simulate_pose", {"homography": np.diag([-1.0, 1.0, 1.0])}, "homography"),
        ("simulate_pose", {"homography": np.ones((3, 3))}, "homography"),
        ("simulate_pose", {"homography": np.diag([1e-9, 1e-9, 1.0])}, "homography"),
        ("judge_homography", {"homography": np.diag([1.0, -1.0, 1.0])}, "homography"),
        ("simulate_pose", {"size": (10**9, 10**9)}, "size"),
        ("reading", {"encoding": "sunlight"}, "encoding"),
        ("read_psf", {"path": ""}, "path"),
    ],
)
def test_what_makes_no_sense_is_named_as_python_spells_it(
    files: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    wrong: dict[str, Any],
    argument: str,
) -> None:
    monkeypatch.chdir(files)
    with pytest.raises(ArgumentError) as refused:
        attrgetter(name)(standoff)(**SOUND[name] | wrong)
    assert refused.value.argument == argument
    assert str(refused.value).startswith(f"{argument}: ")
    assert "--" not in str(refused.value)


def test_a_homography_has_a_sense_where_it_is_made() -> None:
    from calibration.registration import Homography

    for matrix in (np.zeros((3, 3)), np.ones((3, 3)), np.eye(2), np.full((3, 3), np.nan)):
        with pytest.raises(ArgumentError, match="matrix"):
            Homography(matrix=matrix, size=(4, 3))
    with pytest.raises(ArgumentError, match="size"):
        Homography(matrix=np.eye(3), size=(0, 3))
    assert Homography(matrix=2 * np.eye(3), size=(4, 3)).size == (4, 3)


def test_every_number_of_a_public_signature_has_a_range() -> None:
    ranged = {
        parameter
        for name in SOUND
        for parameter, one in inspect.signature(attrgetter(name)(standoff)).parameters.items()
        if isinstance(one.default, int | float | tuple) or "float | None" in str(one.annotation)
        if not isinstance(one.default, bool)
    }
    unranged = ranged - RANGES.keys()
    assert unranged <= ANY_NUMBER, unranged - ANY_NUMBER


ANY_NUMBER = {
    *("aim_px", "contrasts_dn", "levels_dn", "models", "observers", "retake", "sharpening", "want"),
    *("photographs", "limits_mm", "distortion_k1"),
}
"""Numbers of either sign, or that their own type judges."""
