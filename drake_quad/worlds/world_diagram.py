"""Diagram of a world, in which the closed loop of each vehicle is a subsystem.

cf1 ──▶ state, crashed ──▶ proximity ──▶ clearance ──▶ cf1, cf2
cf2 ──▶                └─▶ downwash ──▶ external load ─▶ cf1, cf2
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from drake_quad.assembly.recorder import build_recorder
from drake_quad.assembly.tracking import build_fleet_diagram, reset_fleet_parts
from drake_quad.framework.wiring import build
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.worlds.downwash import Downwash
from drake_quad.worlds.proximity import Proximity, Radii
from drake_quad.worlds.world import World

_WIND_PATH = "laboratory.wind."


def draw_batches(world: World, samples: Sequence[int], *, seed: int | None = None) -> dict[str, Batch]:
    """Draw samples of all vehicles, by the name of the vehicle.

    All vehicles of a sample fly in the same wind. The first vehicle has the random numbers with which it flies alone.
    Parameters and noise of all others are independent of it.
    """
    batches: dict[str, Batch] = {}
    for name, scenario in world.vehicles.items():
        base = scenario.seed if seed is None else seed
        own = base if not batches else _own_seed(base, name)
        batch, of_world = (Batch.draw(scenario, samples, seed=each) for each in (own, base))
        winds = {path: values for path, values in of_world.varying.items() if path.startswith(_WIND_PATH)}
        batches[name] = replace(batch.with_varying(winds), wind_seed=base)
    return batches


def _own_seed(seed: int, name: str) -> int:
    digest = hashlib.blake2b(f"{seed} {name}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") >> 1


def build_world_diagram(
    world: World, batches: Mapping[str, Batch], plans: Mapping[str, Plan], *, record: bool = False
) -> Diagram:
    """Build the diagram of a world, with one world for each sample of the batches.

    The diagram exports the signals of each vehicle under its name, such as `cf1.state`, the signal `cf1.clearance`, and
    `crashed`, which is 1 if all vehicles have crashed.

    Args:
        world: world to build.
        batches: samples to fly, by the name of the vehicle.
        plans: plans that the vehicles follow, by the name of the vehicle.
        record: True to add a recorder, which samples all signals at every control tick.
    """
    builder = DiagramBuilder()
    names, count = [*world.vehicles], len(world.vehicles)
    num_worlds = len(batches[names[0]])
    has_neighbours = count > 1
    has_downwash = has_neighbours and world.downwash is not None

    def closed_loop(name: str) -> Diagram:
        return build_fleet_diagram(
            batches[name], plans[name], has_external_load=has_downwash, has_neighbours=has_neighbours
        )

    vehicles = {name: builder.AddNamedSystem(name, closed_loop(name)) for name in names}
    period = next(iter(world.vehicles.values())).laboratory.command_link.period
    radii = Radii(tuple([world.radius] * count))
    proximity = builder.AddNamedSystem("proximity", Proximity(num_worlds, count=count, period=period, parameters=radii))
    interactions = [proximity]
    if has_downwash:
        assert world.downwash is not None
        downwash = Downwash(num_worlds, count=count, parameters=world.downwash)
        interactions.append(builder.AddNamedSystem("downwash", downwash))
    signals = {"crashed": proximity.GetOutputPort("crashed")}
    for k, (name, vehicle) in enumerate(vehicles.items(), start=1):
        for system in interactions:
            for signal in ("state", "crashed"):
                builder.Connect(vehicle.GetOutputPort(signal), system.GetInputPort(f"{signal}_{k}"))
            for target in ("clearance", "external_load"):
                if system.HasOutputPort(f"{target}_{k}") and vehicle.HasInputPort(target):
                    builder.Connect(system.GetOutputPort(f"{target}_{k}"), vehicle.GetInputPort(target))
        for port in map(vehicle.get_output_port, range(vehicle.num_output_ports())):
            signals[f"{name}.{port.get_name()}"] = port
        signals[f"{name}.clearance"] = proximity.GetOutputPort(f"clearance_{k}")
    for name, port in signals.items():
        builder.ExportOutput(port, name)
    if record:
        recorder = build_recorder({name: port.size() for name, port in signals.items()}, period=period)
        builder.AddNamedSystem("recorder", recorder)
        for name, port in signals.items():
            builder.Connect(port, recorder.GetInputPort(name))
    return build(builder, "world")


def reset_world(diagram: Diagram, context: Context, batches: Mapping[str, Batch], plans: Mapping[str, Plan]) -> None:
    """Reset the context of a diagram for other batches, as if the diagram had been built for them."""
    diagram.SetDefaultContext(context)
    context.SetTime(0.0)
    for name, batch in batches.items():
        reset_fleet_parts(diagram.GetSubsystemByName(name), context, batch, plans[name])
