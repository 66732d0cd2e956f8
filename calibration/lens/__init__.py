"""Lens and camera as a laboratory reports them: each colour, and sharpness and noise together."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
