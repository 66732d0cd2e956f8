"""The camera's PSF: from photographs of edges, of a scene, or from two distances, and its file."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
