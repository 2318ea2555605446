"""Seeds, streams and sources of random numbers."""

from drake_quad.randomness.noise import NoiseSource, Samples, Stream
from drake_quad.randomness.streams import Kind

__all__ = ["Kind", "NoiseSource", "Samples", "Stream"]
