"""Hypothesis for every folder: no deadlines, and on a build machine the same examples each time.

At the desk the search goes on with new examples; what it finds gets an ``@example``.
"""

import os

from hypothesis import settings

settings.register_profile("desk", deadline=None)
settings.register_profile("build", deadline=None, derandomize=True)
settings.load_profile("build" if os.environ.get("CI") else "desk")
