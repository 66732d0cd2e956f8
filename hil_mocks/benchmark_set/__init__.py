"""A public benchmark data set rendered by the simulated bench: cameras, scenes, tasks, truth."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
