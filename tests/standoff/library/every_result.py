"""What every public function returns, of the files that the examples of the reference read."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import standoff

CURVE_TASK = standoff.DetectionTask(
    zooms=(1.0, 1.5),
    models=("matched",),
    observers=("npw",),
    noises_dn=(12.0,),
    reference_zoom=1.0,
    window_px=17,
    signal=standoff.Spot(sigma_px=1.0),
)
PAIR_TASK = standoff.EvaluationTask(
    zooms=(1.0, 1.5), crop_px=64, crops=4, contrasts_dn=(900.0,), noises_dn=(12.0,)
)
TINY_PAIRS = standoff.ChangePairsTask(zooms=(1, 1.5), crop_px=64, pairs=2, test_fraction=0)
DEEP = {"simulated.focus_distance_mm": 300, "simulated.f_number": 1.0}


def _benchmark() -> Any:
    return standoff.score_benchmark(
        "cautious", standoff.make_benchmark("benchmark", size="tiny").out
    )


def _captured() -> Any:
    with standoff.Bench("bench.toml") as bench:
        bench.home()
        return bench.capture()


def _scored() -> Any:
    Path("cautious").mkdir()
    Path("cautious/alignment.json").write_text("{}", encoding="utf-8")
    return standoff.score_benchmark("cautious", result_of("make_benchmark").out)


def _pairs_read() -> Any:
    result_of("change_pairs")
    return standoff.read_change_pairs("pairs")


@cache
def result_of(name: str) -> Any:
    """Return the result of a function, made once; the working folder has the examples' files."""
    return RESULTS[name]()


RESULTS: dict[str, Callable[[], Any]] = {
    "Bench.capture": _captured,
    "alignment_hints": lambda: standoff.alignment_hints(1.2, mask="moving-parts.png"),
    "calibrate_geometry": lambda: standoff.calibrate_geometry("board"),
    "calibrate_psf": lambda: standoff.calibrate_psf(standoff.Session("session")),
    "capture_session": lambda: standoff.capture_session("plan.toml", "bench.toml", "coins"),
    "change_pairs": lambda: standoff.change_pairs("photographs", "pairs", "psf.json", TINY_PAIRS),
    "compare_psfs": lambda: standoff.compare_psfs("psf.json", "lens-files/psf-vertical.json"),
    "d_prime_curves": lambda: standoff.d_prime_curves("before.tif", "psf.json", CURVE_TASK),
    "evaluate": lambda: standoff.evaluate(
        "my_module:detector", "photographs", "psf.json", PAIR_TASK
    ),
    "example_photographs": standoff.example_photographs,
    "export_session": lambda: standoff.export_session("session", "s.ome.tif", format="ome-tiff"),
    "find_changes": lambda: standoff.find_changes("before.tif", "after.tif", "psf.json"),
    "find_changes_of_series": lambda: standoff.find_changes_of_series(
        "before.tif", "after", "changes", "psf.json"
    ),
    "find_focus": lambda: standoff.find_focus(
        "bench.toml", (260, 320), settings=DEEP, steps=9, frames=2, target="coins"
    ),
    "import_photographs": lambda: standoff.import_photographs(
        ["before.tif"], "imported", kind="texture", height_mm=250
    ),
    "judge_homography": lambda: standoff.judge_homography("H.json", "curves.json", 2.0),
    "judge_pose": lambda: standoff.judge_pose("before.tif", "after.tif", "curves.json", 2),
    "judge_poses": lambda: standoff.judge_poses("before.tif", "after", "poses", "curves.json", 2),
    "list_sessions": lambda: standoff.list_sessions("."),
    "make_benchmark": lambda: standoff.make_benchmark("benchmark", size="tiny"),
    "measure_curves": lambda: standoff.measure_curves(
        "photographs", "sweep", "psf.json", CURVE_TASK
    ),
    "measure_edges": lambda: standoff.measure_edges("vertical.tif"),
    "measure_lens": lambda: standoff.measure_lens("vertical.tif"),
    "measure_noise": lambda: standoff.measure_noise("flats"),
    "patch_of": lambda: standoff.patch_of("crack.png"),
    "plan_study": lambda: standoff.plan_study(
        "session.toml", "bench.toml", "psf.json", want="sigma=1%"
    ),
    "pose_limits": lambda: standoff.pose_limits("curves.json", 2, geometry="geometry.json"),
    "preview_plan": lambda: standoff.preview_plan("plan.toml", "bench.toml"),
    "psf_history": lambda: standoff.psf_history("lens-files"),
    "read_change_pairs": lambda: (result_of("change_pairs"), standoff.read_change_pairs("pairs"))[
        1
    ],
    "read_image": lambda: standoff.read_image("before.tif"),
    "register": lambda: standoff.register("before.tif", "after.tif", "psf.json"),
    "score_benchmark": _scored,
    "simulate": lambda: standoff.simulate("before.tif", zoom=2, psf="psf.json"),
    "simulate_pose": lambda: standoff.simulate_pose("before.tif", "H.json", "psf.json"),
    "show_session": lambda: standoff.show_session("session"),
    "training_pairs": lambda: standoff.training_pairs(
        "photographs", "sr-pairs", psf="psf.json", zoom=2, crop_px=96, test_fraction=0
    ),
    "validate": lambda: standoff.validate("session", "psf.json", "validation", models=["matched"]),
    "verify_session": lambda: standoff.verify_session("session"),
    "watch_focus": lambda: standoff.watch_focus(
        "bench.toml", lambda *_: None, readings=3, target="coins"
    ),
    "write_noise": lambda: standoff.write_noise("n.json", result_of("measure_noise")),
    "write_report": lambda: standoff.write_report("session"),
}
