"""The page that makes any phone the follow-up's camera: live guidance, stills, and their changes.

A phone sends frames to be judged and stills to be kept; both are checked as hostile files are. The
work is done in threads here, and nothing is sent elsewhere.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
