"""Random numbers: seeds, streams, and the sources that feed random input ports."""
