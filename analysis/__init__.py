"""Metrics, validation, detectability and reports."""
