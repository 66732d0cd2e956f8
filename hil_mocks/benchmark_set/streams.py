"""Random streams by name: what a task draws depends on the seed and its name alone."""

import hashlib

import numpy as np


def stream(seed: int, *names: str) -> np.random.Generator:
    """Return the generator of a name, independent of those of all others."""
    digest = hashlib.sha256("/".join(names).encode("utf-8")).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words])))
