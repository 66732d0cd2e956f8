"""Several follow-ups compared with a reference: their table, and the time line of each change."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
