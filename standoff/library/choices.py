"""Layouts that callers choose from; imports no library."""

from analysis.choices import PairFormat as PairFormat
