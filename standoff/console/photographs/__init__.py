"""Photographs of one's own that arrive: in parts, whole and verified, and imported as sessions.

They are checked as hostile files are: headers are read here, pixels are decoded elsewhere.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
