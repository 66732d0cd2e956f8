"""What a camera is set to: exposure, gain and black level, what starts a frame, what is off."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
