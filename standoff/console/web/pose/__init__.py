"""The pose card: its messages, its state, its commands, and what is fetched for it."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
