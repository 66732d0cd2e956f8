from .demo import DEMO_FILES as DEMO_FILES, DemoResult as DemoResult, run_demo as run_demo
from .paper import (
    place_errors_px as place_errors_px,
    run_paper as run_paper,
    short_bench as short_bench,
)
