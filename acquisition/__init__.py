"""Devices and capture sessions; the session reader is exported here.

>>> from acquisition import Session
>>> session = Session("sessions/today")

Devices, plans and errors are imported from their own modules and subpackages:
``acquisition.devices``, ``acquisition.errors``, ``acquisition.capture`` and so on.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
