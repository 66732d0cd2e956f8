"""Many follow-ups of one reference: each done once, by this process or others, and listed."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
