"""Layouts and sizes that callers choose from; imports no library."""

from typing import Literal

from analysis.choices import ChangeSigns as ChangeSigns, PairFormat as PairFormat

BenchmarkSize = Literal["tiny", "small", "full"]
"""Of the public benchmark's data set: a few MB, about 100 MB, about 1.5 GB."""
