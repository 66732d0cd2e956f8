"""What is computed from sessions: offered, run as commands of their own, and shown."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
