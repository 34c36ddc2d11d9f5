"""Random streams that depend on what they are for, never on the order of the work."""

import zlib

import numpy as np


def stream(seed: int, *names: object) -> np.random.Generator:
    """A counter-based generator of its own for each purpose.

    Parameters
    ----------
    seed : int
    names : anything with a stable text, such as a capture id and a file name.
    """
    words = [zlib.crc32(str(name).encode()) for name in names]
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, *words])))
