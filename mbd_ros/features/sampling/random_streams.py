"""Random numbers as a function of seed, stream and index."""

import numpy as np


def stream(seed: int, number: int, index: int) -> np.random.Generator:
    """The generator of one index of one stream; what was drawn before does not matter.

    Args:
        seed: >= 0.
        number: Of the stream, as that of a block of chains.
        index: In the stream, as that of a sweep.
    """
    key = np.array([seed, number], dtype=np.uint64)
    counter = np.array([0, 0, 0, index], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=counter))
