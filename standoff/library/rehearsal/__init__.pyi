from ._experiments import (
    DEMO_FILES as DEMO_FILES,
    DemoResult as DemoResult,
    run_demo as run_demo,
    run_paper as run_paper,
    short_bench as short_bench,
)
from ._taken_away import LANTERN_PHOTOGRAPHS as LANTERN_PHOTOGRAPHS
