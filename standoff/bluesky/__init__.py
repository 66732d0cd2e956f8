"""The bench for Bluesky's RunEngine: devices that satisfy its protocols, and a scan of heights.

The devices import nothing of Bluesky; the scan needs ``pip install "standoff[bluesky]"``.
"""

import lazy_loader as lazy

from standoff.shadowing import refuse_hidden_packages

refuse_hidden_packages()
__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
