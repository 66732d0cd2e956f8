"""A dataset of super-resolution pairs: made shard by shard, as files or as tar files, resumable."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
