"""Random numbers: seeds, streams, and the sources that feed random input ports."""

from drake_quad.randomness.noise import NoiseSource, Samples, Stream
from drake_quad.randomness.streams import Kind

__all__ = ["Kind", "NoiseSource", "Samples", "Stream"]
