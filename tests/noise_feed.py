"""Connection of noise to the random ports of a single system."""

from drake_quad.randomness.noise import connect_noise, random_streams


def feed_noise(builder, system, kind, samples):
    """Connect the random ports of a system in a builder to the noise of given samples."""
    name = system.get_name()
    streams = random_streams({name: system}, kind)[name]
    ports = {stream: system.GetInputPort(stream.name.removeprefix(f"{name}.")) for stream in streams}
    connect_noise(builder, ports, samples)
