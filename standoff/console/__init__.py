"""The operator console: a web page over one bench, whose state lives in threads of its own.

The services own the devices, `BenchHub` puts them together, viewers subscribe and send commands.
Nothing here waits for a viewer: a slow one is sent fewer pictures, a lost one changes nothing.
"""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
