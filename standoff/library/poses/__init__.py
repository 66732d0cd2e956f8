"""Live guidance: frames from a folder or a camera, each with a verdict on its pose."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
