"""Worlds in YAML: a scenario with the fields `vehicles` and `world`.

    pair:
      extends: [laboratory:nominal, vehicles/crazyflie, controllers/crazyflie]
      route: {kind: hover, position: [0.0, 0.0, 1.0]}
      world: {radius: 0.1}
      vehicles:
        upper: {offset: [0.0, 0.0, 0.5]}
        lower: {}

All other fields describe every vehicle. The fields of a vehicle are layered over them: `extends` names further layers,
and `offset` shifts the route.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drake_quad.errors import InputError
from drake_quad.scenario.files.layers import with_layer
from drake_quad.scenario.files.library import Library
from drake_quad.scenario.files.loading import Overrides, complete_tree, validate
from drake_quad.scenario.files.marked_tree import Tree
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.world import VEHICLES, WORLD, VehicleSettings, WorldSettings
from drake_quad.worlds.world import World


def is_world(spec: str | Path) -> bool:
    """Return whether a file contains several vehicles.

    Raises:
        InputError: if the file or the scenario does not exist, or the file is not YAML.
    """
    return VEHICLES in Library().find(spec)[1].value


def load_world(spec: str | Path, overrides: Overrides = ()) -> World:
    """Load a world.

    Args:
        spec: FILE, or FILE:NAME if the file contains several scenarios.
        overrides: overrides of fields of all vehicles, as in `load_scenario`.

    Raises:
        InputError: if the file or an override is wrong; the message names the file, line, field, value and the allowed
            values.
    """
    library = Library()
    name, tree = library.find(spec)
    if VEHICLES not in tree.value:
        raise InputError(f"{tree.mark}: has no field vehicles; `load_scenario` loads a scenario of a single vehicle")
    vehicles = tree.value[VEHICLES]
    if not isinstance(vehicles.value, dict):
        raise InputError(f"{vehicles.mark}: vehicles must be a mapping from the names of the vehicles to their fields")
    settings = validate(WorldSettings, tree.value.get(WORLD, Tree({}, tree.mark)))
    template = Tree({key: part for key, part in tree.value.items() if key not in (VEHICLES, WORLD)}, tree.mark)
    scenarios: dict[str, Scenario] = {}
    offsets: dict[str, Any] = {}
    for vehicle, part in vehicles.value.items():
        fields = _fields(part, vehicle)
        own = {key: each for key, each in fields.items() if key not in VehicleSettings.model_fields}
        given = {key: _as_list(each) if key == "extends" else each for key, each in fields.items() if key not in own}
        vehicle_settings = validate(VehicleSettings, Tree(given, part.mark))
        merged = template
        for layer in vehicle_settings.extends:
            merged = with_layer(merged, library.find(layer)[1])
        merged = with_layer(merged, Tree(own, part.mark))
        scenarios[vehicle] = validate(Scenario, complete_tree(vehicle, merged, library, overrides))
        if vehicle_settings.offset is not None:
            offsets[vehicle] = vehicle_settings.offset
    downwash = None if settings.downwash is None else settings.downwash.parameters()
    return World(scenarios, settings.radius, downwash, offsets, name)


def _fields(part: Tree, vehicle: str) -> Mapping[str, Tree]:
    if part.value is None:
        return {}
    if not isinstance(part.value, dict):
        raise InputError(f"{part.mark}: vehicles.{vehicle} must be a mapping of fields, such as offset or route")
    return part.value


def _as_list(tree: Tree) -> Tree:
    return tree if isinstance(tree.value, list) else Tree([tree], tree.mark)
