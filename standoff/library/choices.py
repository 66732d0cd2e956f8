"""Layouts that callers choose from; imports no library."""

from analysis.choices import ChangeSigns as ChangeSigns, PairFormat as PairFormat
