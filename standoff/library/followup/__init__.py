"""How a scene looks from further away or from another pose, and through the camera."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
