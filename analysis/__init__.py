"""Metrics, comparison with captures, and reports."""
