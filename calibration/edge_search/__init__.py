"""Find straight edges in photographs: gradient, ridges, lines, and what of them can be fitted."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
