"""Regions without a straight edge that give a number all the same, and true edges that are refused.

Neither comes from the measurement: see ``truth.edges``. Thresholds were chosen on other seeds.
*Before* is the same measurement without the flags that are meant for what is no edge. A true edge
is one whose width comes within 10 % of the truth; others in its region are not on it.

    python -m benchmarks.studies.no_edge [--seed 7000] [--quick]
"""

from collections import Counter
from functools import partial
from typing import Annotated

import numpy as np

import calibration.edges.measurement as measurement
from benchmarks.harness import Recorder, benchmark, shortest_s
from benchmarks.truth.edges import RegionMaker, edges_of_bench, with_edges, without_edges
from calibration.edges import EdgeImage, EdgeMeasurement, border_flags, edges_of_image
from tests.calibration.closed_form import edge_image

NOT_AN_EDGE = frozenset({"uneven", "curved"})
NEAR = 0.1
VAGUE = 0.1  # of sigma: refused as too noisy


def _was_used(edge: EdgeMeasurement) -> bool:
    """Whether the edge counted where only saturation, length and contrast exclude one."""
    flags = set(edge.flags) - NOT_AN_EDGE
    is_vague = edge.sigma_err_px > VAGUE * edge.sigma_px and (edge.snr or np.inf) >= 3.0
    return not flags & (measurement.REJECTING_FLAGS - ({"too_noisy"} if is_vague else set()))


def _remarks(edge: EdgeMeasurement) -> set[str]:
    """Flags of an edge apart from that of the file."""
    return set(edge.flags) - {"jpeg"}


def _false_numbers(record: Recorder, count: int, seed: int) -> None:
    made, before, used, bare = Counter[str](), Counter[str](), Counter[str](), Counter[str]()
    bare_before = 0
    for region in without_edges(count, seed):
        edges = edges_of_image(region.source)
        made[region.kind] += 1
        before[region.kind] += any(_was_used(edge) for edge in edges)
        used[region.kind] += any(edge.is_used for edge in edges)
        bare[region.kind] += any(not _remarks(edge) for edge in edges)
        new = NOT_AN_EDGE | {"too_noisy"}
        bare_before += any(_was_used(edge) and not _remarks(edge) - new for edge in edges)
    record.say(f"\n{count} regions without a straight edge: how many give a number")
    record.say(f"  {'':24} regions  before  now  now, without any flag")
    for kind in sorted(made):
        record.say(f"  {kind:24} {made[kind]:7d} {before[kind]:7d} {used[kind]:4d} {bare[kind]:8d}")
    for name, number in (
        ("a number, before", before.total()),
        ("a number without any flag, before", bare_before),
        ("a number", used.total()),
        ("a number without any flag", bare.total()),
    ):
        record.figure(f"no edge: {name}", 100 * number / count, "%")
        record.say(f"  {name:36} {100 * number / count:6.2f} %")


def _refused(record: Recorder, name: str, make: RegionMaker, count: int, seed: int) -> None:
    true = lost = 0
    why = Counter[str]()
    for region in make(count, seed):
        assert region.sigma_px is not None
        for edge in edges_of_image(region.source):
            if not _was_used(edge) or abs(edge.sigma_px / region.sigma_px - 1) > NEAR:
                continue
            true += 1
            new = measurement.REJECTING_FLAGS & set(edge.flags)
            lost += bool(new)
            why.update(f"{region.kind}: {flag}" for flag in new)
    record.figure(f"true edges refused, {name}", 100 * lost / true, "%")
    record.say(
        f"  {name:24} {true:6d} edges, refused {lost} ({100 * lost / true:.2f} %) {dict(why)}"
    )


def _cost(record: Recorder) -> None:
    """Time of one edge with the flags for what is no edge, and without."""
    record.say(
        "\none edge of 90 px at 5 degrees, all of the measurement\n  sigma  with ms  without ms"
    )
    for sigma_px in (0.5, 1.5):
        image = edge_image(sigma_px, 5.0)
        image += np.random.default_rng(1).normal(0, 400, image.shape)
        source = EdgeImage(name="edge", image_dn=image, saturation_dn=65_535.0)
        with_s, without_s = shortest_s(
            [partial(edges_of_image, source), partial(_without_border, source)],
            record.pick(4.0, 0.3),
        )
        record.figure(
            f"measurement of one edge, sigma {sigma_px} px",
            with_s * 1e3,
            "ms",
            "without the flags for what is no edge",
            without_s * 1e3,
        )
        record.say(f"  {sigma_px:5.1f} {1e3 * with_s:8.3f} {1e3 * without_s:11.3f}")


def _without_border(source: EdgeImage) -> None:
    measurement.border_flags = lambda *_, **__: ()  # type: ignore[attr-defined]  # imported there
    try:
        edges_of_image(source)
    finally:
        measurement.border_flags = border_flags  # type: ignore[attr-defined]  # as before


@benchmark("numpy", "numba", "scikit-image")
def main(record: Recorder, *, seed: Annotated[int, "of all that is drawn"] = 7000) -> None:
    count = record.pick(1000, 60)
    _false_numbers(record, count, seed)
    record.say("\ntrue edges")
    _refused(record, "closed form", with_edges, count, seed + 1)
    _refused(record, "bench", edges_of_bench, record.pick(60, 4), seed + 2)
    _cost(record)
