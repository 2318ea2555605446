"""Tests of noise sources: their numbers, periods and connections to the random ports of systems."""

import numpy as np
import oracle.randomness
import pytest
from pydrake.common import RandomDistribution, RandomGenerator
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from drake_quad.laboratory.wind.dryden import DrydenTurbulence, Turbulence, TurbulenceParameters
from drake_quad.randomness.noise import (
    EXPORTED_PREFIX,
    ExportedRandomNumbers,
    NoiseSource,
    Stream,
    connect_noise,
    connect_random_sources,
    export_noise,
    random_streams,
)
from drake_quad.randomness.streams import Samples, StreamKind

GAUSSIAN, UNIFORM = RandomDistribution.kGaussian, RandomDistribution.kUniform


class SourceOfOneStream:
    """Noise source with a single stream, and its context."""

    def __init__(self, stream, samples):
        self.source = NoiseSource(num_vehicles=len(samples.indices), streams=[stream], parameters=samples)

    def at(self, time):
        """Return the (n · N,) numbers at a time (s), for n numbers per vehicle."""
        return source_numbers(self.source, time)


def numbers_of(samples, rows=3, distribution=GAUSSIAN, period=0.01, name="n"):
    return SourceOfOneStream(Stream(name, StreamKind.NOISE, rows, distribution, period), Samples(5, samples))


def source_numbers(source, time, context=None):
    """Return the (n · N,) numbers of a source at a time (s), for n numbers per vehicle."""
    context = context or source.CreateDefaultContext()
    context.SetTime(time)
    return source.get_output_port().Eval(context)


@pytest.mark.parametrize("distribution", [GAUSSIAN, UNIFORM])
@pytest.mark.parametrize("rows", [1, 2, 5, 6])
def test_the_numbers_of_a_tick_depend_only_on_the_tick_and_the_sample(distribution, rows):
    times = [0.01 * tick for tick in (0, 1, 2, 3, 700, 701, 5000, 4)]
    many_vehicles = numbers_of(range(3000), rows, distribution)
    one_vehicle = numbers_of([2999], rows, distribution)
    two_vehicles = numbers_of([2999, 12], rows, distribution)
    for time in times:
        expected = one_vehicle.at(time)
        np.testing.assert_array_equal(many_vehicles.at(time).reshape(rows, -1)[:, 2999], expected)
        np.testing.assert_array_equal(two_vehicles.at(time).reshape(rows, -1)[:, 0], expected)
        np.testing.assert_array_equal(numbers_of([2999], rows, distribution).at(time), expected)


@pytest.mark.parametrize("kind", [StreamKind.WIND, StreamKind.NOISE])
def test_a_stream_equals_an_independent_implementation(kind):
    """The independent implementation uses Python integers for SplitMix64, and the method of Box and Muller."""
    name = "motion_capture.camera_noise"
    expected = oracle.randomness.Stream(5, 12, int(kind), name, 3)
    for distribution, numbers in ((GAUSSIAN, expected.normal), (UNIFORM, expected.uniform)):
        actual = SourceOfOneStream(Stream(name, kind, 3, distribution, 0.01), Samples(5, [12]))
        for tick in (0, 1, 2, 3, 682, 683, 5001):
            np.testing.assert_allclose(actual.at(0.01 * tick), numbers(tick), rtol=1e-14)


def test_a_stream_does_not_depend_on_other_streams_of_its_source():
    streams = [
        Stream("a", StreamKind.NOISE, 3, GAUSSIAN, 0.01),
        Stream("b", StreamKind.WIND, 1, UNIFORM, 0.01),
        Stream("c", StreamKind.WIND, 2, GAUSSIAN, 0.01),
    ]
    samples = Samples(5, [4, 1])
    together = NoiseSource(num_vehicles=2, streams=streams, parameters=samples)
    for time in (0.0, 0.01, 7.0, 50.01):
        separate = [SourceOfOneStream(stream, samples).at(time) for stream in streams]
        np.testing.assert_array_equal(source_numbers(together, time), np.concatenate(separate))


def test_no_random_number_is_repeated():
    stream = numbers_of([0, 1], rows=3)
    numbers = np.concatenate([stream.at(0.01 * tick) for tick in range(3000)])
    assert np.unique(numbers.reshape(-1, 6), axis=0).shape == (3000, 6)
    assert numbers.std() == pytest.approx(1.0, abs=0.02)


def test_a_source_can_have_streams_with_different_periods():
    samples = Samples(5, [0])
    streams = Stream("n", StreamKind.NOISE, 2, GAUSSIAN, 0.01), Stream("slow", StreamKind.NOISE, 1, UNIFORM, 0.02)
    fast, slow = (SourceOfOneStream(stream, samples) for stream in streams)
    builder = DiagramBuilder()
    source = builder.AddNamedSystem("noise", NoiseSource(streams=streams, parameters=samples))
    log = LogVectorOutput(source.get_output_port(), builder, publish_period=0.01)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.0)
    actual = log.FindLog(simulator.get_context()).data()
    for tick in range(100):
        np.testing.assert_array_equal(actual[:2, tick], fast.at(0.01 * tick))
    # Between two ticks, a stream has the output of the nearest tick.
    np.testing.assert_array_equal(actual[2, 0:100:4], [slow.at(0.04 * i)[0] for i in range(25)])


def test_the_numbers_in_each_noise_period_are_those_of_its_sample():
    stream, period = Stream("n", StreamKind.NOISE, 3, GAUSSIAN, 0.01), 0.05
    samples = Samples(5, [4, 1], later_indices=[[7, 1], [4, 9]], period=period)
    source = NoiseSource(num_vehicles=2, streams=[stream], noise_period=period, parameters=samples)
    for tick in range(20):
        # The last period has no end.
        indices = [samples.indices, *samples.later_indices][min(tick // 5, 2)]
        expected = SourceOfOneStream(stream, Samples(5, indices)).at(0.01 * tick)
        np.testing.assert_array_equal(source_numbers(source, 0.01 * tick), expected)


def test_a_context_that_is_reset_to_other_samples_has_the_random_numbers_of_these_samples():
    """Neither other contexts nor the source itself change."""
    streams = [Stream("a", StreamKind.NOISE, 3, GAUSSIAN, 0.01), Stream("b", StreamKind.WIND, 1, UNIFORM, 0.02)]
    first, second = Samples(5, [4, 1]), Samples(6, [2, 9])
    source, other = (NoiseSource(num_vehicles=2, streams=streams, parameters=samples) for samples in (first, second))
    untouched, context = source.CreateDefaultContext(), source.CreateDefaultContext()
    original_numbers = source_numbers(source, 0.5, untouched)
    source.reset(context, second)
    np.testing.assert_array_equal(source_numbers(source, 0.5, context), source_numbers(other, 0.5))
    assert (source_numbers(source, 0.5, context) != original_numbers).all()
    for unchanged_context in (untouched, source.CreateDefaultContext()):
        np.testing.assert_array_equal(source_numbers(source, 0.5, unchanged_context), original_numbers)


def turbulent_builder(num_vehicles):
    """Return a builder with two turbulence systems, and their random ports by stream."""
    turbulence = Turbulence.at_low_altitude(height=10.0, wind_at_20_feet=15.0, airspeed=5.0)
    builder = DiagramBuilder()
    sources = {
        name: DrydenTurbulence(num_vehicles=num_vehicles, period=0.02, parameters=TurbulenceParameters(turbulence))
        for name in "ab"
    }
    for name, source in sources.items():
        builder.AddNamedSystem(name, source)
    streams = random_streams(sources, StreamKind.WIND)
    return builder, {streams[name][0]: source.GetInputPort("turbulence_noise") for name, source in sources.items()}


def test_a_stream_is_named_after_its_system_and_port():
    _, ports = turbulent_builder(1)
    name = "turbulence_noise"
    assert [*ports] == [Stream(f"{system}.{name}", StreamKind.WIND, 5, GAUSSIAN, 0.02) for system in "ab"]


@pytest.mark.parametrize(
    ("samples", "sources"),
    [([3], {"noise", "noise_parts"}), ([3, 4], {"noise_a.turbulence_noise", "noise_b.turbulence_noise"})],
)
def test_the_ports_of_a_single_vehicle_share_a_noise_source_and_those_of_a_fleet_do_not(samples, sources):
    """Every port receives the numbers of its own stream."""
    builder, ports = turbulent_builder(len(samples))
    connect_noise(builder, ports, Samples(7, tuple(samples)))
    diagram = builder.Build()
    assert {system.get_name() for system in diagram.GetSystems()} == {"a", "b"} | sources
    context = diagram.CreateDefaultContext()
    context.SetTime(0.08)
    for stream, port in ports.items():
        actual = port.Eval(port.get_system().GetMyContextFromRoot(context))
        np.testing.assert_array_equal(actual, SourceOfOneStream(stream, Samples(7, samples)).at(0.08))


def test_random_sources_of_drake_can_replace_the_streams():
    builder, ports = turbulent_builder(2)
    connect_random_sources(builder, ports)
    diagram = builder.Build()
    names = {system.get_name() for system in diagram.GetSystems()}
    assert names == {"a", "b", "random_a.turbulence_noise", "random_b.turbulence_noise"}
    context = diagram.CreateDefaultContext()
    diagram.SetRandomContext(context, RandomGenerator(3))
    numbers = [port.Eval(port.get_system().GetMyContextFromRoot(context)) for port in ports.values()]
    assert np.unique(numbers).size == 2 * 5 * 2


@pytest.mark.slow
@pytest.mark.parametrize("num_vehicles", [1, 2])
def test_exported_numbers_of_a_period_are_in_the_order_of_its_ticks(num_vehicles):
    """A period of 60 ms contains three ticks of the turbulence, each with five numbers for every vehicle."""
    builder, ports = turbulent_builder(num_vehicles)
    export_noise(builder, ports, ExportedRandomNumbers(0.06), num_vehicles)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    random_numbers = np.random.default_rng(2).normal(size=(2, 3, 5 * num_vehicles))
    for stream, numbers in zip(ports, random_numbers, strict=True):
        diagram.GetInputPort(EXPORTED_PREFIX + stream.name).FixValue(context, numbers.ravel())
    for tick in range(9):
        context.SetTime(0.02 * tick)
        for port, numbers in zip(ports.values(), random_numbers, strict=True):
            actual = port.Eval(port.get_system().GetMyContextFromRoot(context))
            np.testing.assert_array_equal(actual, numbers[tick % 3])
