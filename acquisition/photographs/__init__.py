"""Photographs in: any image file, with its levels linear in light, or refused in one line."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
