"""How often the cross-validation of the geometry names a fault, and at which size.

Surveys of five heights by the simulated bench's own optics, a board and a texture in turn, with
0.03 px of noise. Without a fault every sentence is a false one; a fault is found if it is named, or
if the captures that have it are left out by name.
"""

from benchmarks.harness import Recorder, benchmark
from calibration.geometry.cross_validation import cross_validation
from tests.calibration.faulty_survey import Fault, surveyed

WORDS: dict[Fault, str] = {
    "heights": "heights wander",
    "travel": "does not travel straight",
    "sag": "not flat",
}
SIZES = (0.0025, 0.005, 0.01, 0.02)
"""Over the camera's distance; a zoom that is off by 0.02 moves d' by 5 %."""


def _is_named(seed: int, fault: Fault, size: float) -> bool:
    """Whether a survey with this fault says so."""
    kind = "board" if fault == "sag" or seed % 2 else "texture"
    found = surveyed(seed, kind, fault, size)
    if found.exclusions or found.notes:
        return True
    faults = cross_validation(found.adjustment, found.pupil).faults
    return any(WORDS[fault] in text for text in faults)


@benchmark()
def main(record: Recorder) -> None:
    clean = record.pick(200, 20)
    false = 0
    for seed in range(clean):
        found = surveyed(seed, "board" if seed % 2 else "texture")
        false += bool(cross_validation(found.adjustment, found.pupil).faults)
    record.say(f"{false} of {clean} surveys without a fault name one")
    record.figure("surveys without a fault that name one", false / clean, "share")
    draws = record.pick(40, 5)
    for fault in WORDS:
        for size in SIZES:
            named = sum(_is_named(1000 + seed, fault, size) for seed in range(draws))
            record.say(f"{fault}, {100 * size:g} % of the distance: {named} of {draws} named")
            record.figure(f"{fault} of {100 * size:g} % named", named / draws, "share")
