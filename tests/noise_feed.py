"""Connection of noise sources to the random input ports of a single system."""

from drake_quad.randomness.noise import connect_noise, random_streams


def feed_noise(builder, system, kind, samples):
    """Connect the random input ports of a system to noise sources.

    Args:
        builder: diagram builder that contains the system.
        system: system with random input ports.
        kind: `StreamKind` of the noise.
        samples: `Samples` whose seed and indices determine the noise.
    """
    name = system.get_name()
    streams = random_streams({name: system}, kind)[name]
    ports = {stream: system.GetInputPort(stream.name.removeprefix(f"{name}.")) for stream in streams}
    connect_noise(builder, ports, samples)
