"""The public benchmark: its data set, made here, and the scores of programs on it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
