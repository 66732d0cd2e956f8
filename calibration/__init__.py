"""Photographs to calibrations: PSF, noise, geometry, and the registration of two views.

Each is imported from its room: ``calibration.edges``, ``calibration.psf`` and so on.
"""
