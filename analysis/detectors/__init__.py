"""Detectors of changes: those that come with the project, and anybody's own, run and checked."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
