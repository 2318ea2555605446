import numpy as np
import oracle.randomness
import pytest
from pydrake.common import RandomDistribution
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from drake_quad.randomness.noise import Samples, Stream, Tape, TapePlayer, connect_tapes, random_ports
from drake_quad.laboratory.wind.dryden import DrydenTurbulence, Turbulence
from drake_quad.randomness.streams import Kind

GAUSSIAN, UNIFORM = RandomDistribution.kGaussian, RandomDistribution.kUniform


def tape(samples, rows=3, distribution=GAUSSIAN, period=0.01, name="n"):
    return Tape(Samples(5, samples), [Stream(name, Kind.NOISE, rows, distribution)], period=period)


@pytest.mark.parametrize("distribution", [GAUSSIAN, UNIFORM])
@pytest.mark.parametrize("rows", [1, 2, 5, 6])
def test_what_stands_at_a_tick_depends_on_the_tick_and_the_sample_alone(distribution, rows):
    times = [0.01 * tick for tick in (0, 1, 2, 3, 700, 701, 5000, 4)]
    crowd = tape(range(3000), rows, distribution)
    one = tape([2999], rows, distribution)
    few = tape([2999, 12], rows, distribution)
    for time in times:
        alone = one.at(time)
        np.testing.assert_array_equal(crowd.at(time).reshape(rows, -1)[:, 2999], alone)
        np.testing.assert_array_equal(few.at(time).reshape(rows, -1)[:, 0], alone)
        np.testing.assert_array_equal(tape([2999], rows, distribution).at(time), alone)


@pytest.mark.parametrize("kind", [Kind.WIND, Kind.NOISE])
def test_a_tape_plays_what_the_oracle_makes_number_by_number(kind):
    """SplitMix64 and Box and Muller, with Python's whole numbers."""
    name = "motion_capture.camera_noise"
    expected = oracle.randomness.Stream(5, 12, int(kind), name, 3)
    for distribution, numbers in ((GAUSSIAN, expected.normal), (UNIFORM, expected.uniform)):
        played = Tape(Samples(5, [12]), [Stream(name, kind, 3, distribution)], period=0.01)
        for tick in (0, 1, 2, 3, 682, 683, 5001):
            np.testing.assert_allclose(played.at(0.01 * tick), numbers(tick), rtol=1e-14)


def test_streams_are_the_same_beside_others_on_a_tape():
    streams = [
        Stream("a", Kind.NOISE, 3, GAUSSIAN),
        Stream("b", Kind.WIND, 1, UNIFORM),
        Stream("c", Kind.WIND, 2, GAUSSIAN),
    ]
    samples = Samples(5, [4, 1])
    together = Tape(samples, streams, period=0.01)
    for time in (0.0, 0.01, 7.0, 50.01):
        apart = [Tape(samples, [stream], period=0.01).at(time) for stream in streams]
        np.testing.assert_array_equal(together.at(time), np.concatenate(apart))


def test_no_number_stands_twice():
    played = tape([0, 1], rows=3)
    numbers = np.concatenate([played.at(0.01 * tick) for tick in range(3000)])
    assert np.unique(numbers.reshape(-1, 6), axis=0).shape == (3000, 6)
    assert numbers.std() == pytest.approx(1.0, abs=0.02)


def test_a_player_plays_tapes_of_several_periods():
    fast, slow = tape([0], 2), tape([0], 1, UNIFORM, period=0.02, name="slow")
    builder = DiagramBuilder()
    player = builder.AddNamedSystem("tapes", TapePlayer(tapes=[fast, slow]))
    log = LogVectorOutput(player.get_output_port(), builder, publish_period=0.01)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(1.0)
    found = log.FindLog(simulator.get_context()).data()
    for tick in range(100):
        np.testing.assert_array_equal(found[:2, tick], fast.at(0.01 * tick))
    # Between two ticks of the slower tape the nearest one counts.
    np.testing.assert_array_equal(found[2, 0:100:4], [slow.at(0.04 * i)[0] for i in range(25)])


@pytest.mark.parametrize(
    ("samples", "players"),
    [([3], {"tapes", "tapes_parts"}), ([3, 4], {"tape_a.turbulence_noise", "tape_b.turbulence_noise"})],
)
def test_a_lone_vehicle_has_one_player_and_a_fleet_one_for_each_port(samples, players):
    turbulence = Turbulence.at_low_altitude(height=10.0, wind_at_20_feet=15.0, airspeed=5.0)
    builder = DiagramBuilder()
    sources = {name: DrydenTurbulence(num_vehicles=len(samples), turbulence=turbulence) for name in "ab"}
    for name, source in sources.items():
        builder.AddNamedSystem(name, source)
    connect_tapes(builder, random_ports(sources, Kind.WIND), Samples(0, tuple(samples)))
    assert {system.get_name() for system in builder.Build().GetSystems()} == {"a", "b"} | players
