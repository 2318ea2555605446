"""Which samples of a study are not there, without a list of millions."""

from collections.abc import Sequence
from typing import Any

import numpy as np


class MissingSamples(Sequence[int]):
    """The numbers of the samples of a study that are not there, in order.

    They take no more memory than the numbers of those that are there.

    Args:
        num_samples: how many samples there are to be.
        there: (n,) numbers of the samples that are there, each once, in any order.
    """

    def __init__(self, num_samples: int, there: np.ndarray) -> None:
        self._count = num_samples - len(there)
        # How many are missing before each one that is there.
        self._before = np.sort(there.astype(int)) - np.arange(len(there))

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, place: Any) -> Any:
        """The sample at a place among those that are missing, or a list of those at a slice."""
        places = range(self._count)[place]
        found = np.asarray(places, dtype=int) + np.searchsorted(self._before, places, side="right")
        return found.tolist()
