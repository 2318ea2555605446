"""Indices of the missing samples of a study, which are computed on demand to save memory."""

from collections.abc import Sequence
from typing import Any

import numpy as np


class MissingSamples(Sequence[int]):
    """Sorted indices of the missing samples of a study. The memory grows with the number of present samples only.

    Args:
        num_samples: number of samples in the complete study.
        present: (n,) indices of the present samples, without repetition, in any order.
    """

    def __init__(self, num_samples: int, present: np.ndarray) -> None:
        self._count = num_samples - len(present)
        # Element i is the number of missing samples before the i-th present sample.
        self._num_missing_before = np.sort(present.astype(int)) - np.arange(len(present))

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Any:
        """Return the missing sample at an index, or the list of missing samples in a slice."""
        positions = range(self._count)[index]
        samples = np.asarray(positions, dtype=int) + np.searchsorted(self._num_missing_before, positions, side="right")
        return samples.tolist()
