"""Edges to PSF, noise, registration and geometry."""
