"""Random parameters of a study that cover their distributions more evenly than independent samples.

Each replicate of a study is a Latin hypercube (M. D. McKay, R. J. Beckman and W. J. Conover, "A comparison of three
methods for selecting values of input variables", Technometrics, 1979), or a scrambled Sobol sequence (A. B. Owen,
"Monte Carlo variance of scrambled net quadrature", SIAM Journal on Numerical Analysis, 1997). The samples within a
replicate depend on one another, so confidence intervals are computed from the spread of independent replicates.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
import scipy
from pydantic import Field, model_validator

from drake_quad.randomness.streams import parameter_numbers
from drake_quad.scenario.distributions import Model

LATIN_HYPERCUBE = "latin_hypercube"
SOBOL = "sobol"
MAX_SIZE = 2**16
"""Largest number of samples in a replicate. Each batch computes the draws of all samples of its replicates."""
_SOBOL_BITS = 30  # binary digits of the numbers of a Sobol sequence
_SOBOL_KEY = 3  # distinguishes the seeds of Sobol sequences from other seeds; see `StreamKind`


class DesignedDraws(Model):
    """Draws of a study in independent replicates, each of which covers all distributions evenly."""

    kind: Literal["latin_hypercube", "sobol"] = Field(
        description="`latin_hypercube`: in each replicate, each random field has one value in each of `size`"
        " intervals with equal probabilities; `sobol`: a scrambled Sobol sequence, which also covers combinations of"
        " fields evenly"
    )
    size: Annotated[int, Field(ge=2, le=MAX_SIZE)] = Field(
        description="number of samples in each replicate; a power of two for `sobol`"
    )

    @model_validator(mode="after")
    def _size_fits_kind(self) -> "DesignedDraws":
        if self.kind == SOBOL and self.size & (self.size - 1):
            raise self.field_error("must be a power of two for sobol", "size")
        return self

    def replicates(self, samples: np.ndarray) -> np.ndarray:
        """Return the (N,) indices of the replicates to which samples belong."""
        return np.asarray(samples) // self.size

    def numbers(self, seed: int, samples: Sequence[int], streams: Sequence[str]) -> dict[str, np.ndarray]:
        """Return the (N,) uniform numbers in (0, 1) of each stream, by its name.

        In a Latin hypercube, the numbers of a stream depend only on its own name. In a Sobol sequence, they depend on
        the names of all streams.

        Args:
            seed: seed of the study.
            samples: (N,) indices of the samples.
            streams: names of the random streams, one for each drawn field and each shared variable.
        """
        replicates, members = np.unique(self.replicates(np.asarray(samples)), return_inverse=True)
        indices, streams = np.asarray(samples) % self.size, sorted(streams)
        if self.kind == SOBOL:
            points = [self._sobol_points(seed, int(replicate), len(streams)) for replicate in replicates]
            cells = np.stack(points)[members, indices]
            width = 2.0**-_SOBOL_BITS
        else:
            cells = np.stack([self._ranks(seed, replicates, name)[members, indices] for name in streams], axis=1)
            width = 1.0 / self.size
        # The design selects a cell, one of several intervals of equal width, for each number. Within its cell, the
        # number is uniformly distributed and does not depend on the design.
        inside = np.stack([parameter_numbers(seed, samples, name) for name in streams], axis=1)
        smallest = 2.0**-53
        numbers = np.clip((cells + inside) * width, smallest, 1.0 - smallest)
        return dict(zip(streams, numbers.T, strict=True))

    def _ranks(self, seed: int, replicates: np.ndarray, stream: str) -> np.ndarray:
        """Return a random permutation of 0 to `size` - 1 for each replicate, (replicates, size)."""
        samples = (replicates[:, None] * self.size + np.arange(self.size)).ravel().tolist()
        keys = parameter_numbers(seed, samples, f"{stream} order").reshape(-1, self.size)
        return np.argsort(np.argsort(keys, axis=1), axis=1)

    def _sobol_points(self, seed: int, replicate: int, dimension: int) -> np.ndarray:
        """Return the points of a Sobol sequence, which is scrambled differently for each replicate.

        The points are integers of `_SOBOL_BITS` bits, (size, dimension).
        """
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(replicate, _SOBOL_KEY)))
        sequence = scipy.stats.qmc.Sobol(dimension, bits=_SOBOL_BITS, seed=generator)
        return np.rint(sequence.random(self.size) * 2.0**_SOBOL_BITS)
