"""The truth in closed form: scenes, optics, light and sensor; nothing judged shares its code."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
