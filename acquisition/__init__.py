"""Devices and capture sessions.

What reads a session, and every error, is exported here. Whoever drives devices or writes
sessions imports the module: ``acquisition.devices``, ``acquisition.capture.runner``, ...
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
