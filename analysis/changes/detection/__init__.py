"""Changes looked for behind filters of several widths, and what these would have found."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
