"""Seeds, streams and sources of random numbers."""
