"""Indices of the missing samples of a study, without a list that could have millions of entries."""

from collections.abc import Sequence
from typing import Any

import numpy as np


class MissingSamples(Sequence[int]):
    """Sorted indices of the missing samples of a study, in no more memory than the indices of the present ones.

    Args:
        num_samples: number of samples in the complete study.
        present: (n,) indices of the present samples, without repetition, in any order.
    """

    def __init__(self, num_samples: int, present: np.ndarray) -> None:
        self._count = num_samples - len(present)
        # The array contains the number of missing samples before each present one.
        self._before = np.sort(present.astype(int)) - np.arange(len(present))

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, place: Any) -> Any:
        """Return the missing sample at a position, or the list of missing samples at a slice."""
        places = range(self._count)[place]
        found = np.asarray(places, dtype=int) + np.searchsorted(self._before, places, side="right")
        return found.tolist()
