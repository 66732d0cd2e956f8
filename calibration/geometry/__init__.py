"""The geometry of a height series: scale, pupil, distortion, stage axis."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
