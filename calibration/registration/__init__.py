"""Aligning two photographs of one scene to a small fraction of a pixel."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
