"""Whether the edges agree with the model of the camera, and what of them is the target's."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
