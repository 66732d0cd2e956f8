"""Edges to PSF, noise and registration."""
