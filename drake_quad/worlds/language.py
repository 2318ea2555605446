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
from typing import Any, TypeVar

from ruamel.yaml import YAML

from drake_quad.errors import InputError
from drake_quad.files import write_atomically
from drake_quad.scenario.files.layers import with_layer
from drake_quad.scenario.files.library import Library
from drake_quad.scenario.files.loading import Overrides, complete_tree, validate
from drake_quad.scenario.files.marked_tree import Tree
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.world import VEHICLES, WORLD, VehicleSettings, WorldSettings
from drake_quad.worlds.world import World

_AnyModel = TypeVar("_AnyModel", WorldSettings, VehicleSettings)


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
    settings = _validated(WorldSettings, tree.value.get(WORLD, Tree({}, tree.mark)), WORLD)
    template = Tree({key: part for key, part in tree.value.items() if key not in (VEHICLES, WORLD)}, tree.mark)
    scenarios: dict[str, Scenario] = {}
    offsets: dict[str, Any] = {}
    for vehicle, part in vehicles.value.items():
        fields = _fields(part, vehicle)
        merged, path = template, f"{VEHICLES}.{vehicle}"
        for layer in library.layers(fields["extends"]) if "extends" in fields else ():
            merged = with_layer(merged, layer)
        own = {key: each for key, each in fields.items() if key not in VehicleSettings.model_fields}
        merged = with_layer(merged, Tree(own, part.mark))
        try:
            scenarios[vehicle] = validate(Scenario, complete_tree(vehicle, merged, library, overrides))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        if "offset" in fields:
            given = Tree({"offset": fields["offset"]}, part.mark)
            offsets[vehicle] = _validated(VehicleSettings, given, path).offset
    downwash = None if settings.downwash is None else settings.downwash.parameters()
    try:
        return World(scenarios, settings.radius, downwash, offsets, name)
    except InputError as error:
        raise InputError(f"{vehicles.mark}: {error}") from None


def save_world(world: World, path: Path) -> Path:
    """Write a world beside a folder `NAME` of the saved flight of each vehicle, so that it can be flown again."""
    seed = next(iter(world.vehicles.values())).seed
    downwash = None if world.downwash is None else world.downwash._asdict()
    vehicles = {
        name: {"extends": f"{name}/scenario.yaml", "seed": seed}
        | ({"offset": [float(each) for each in world.offsets[name]]} if name in world.offsets else {})
        for name in world.vehicles
    }
    settings = {"radius": float(world.radius), "downwash": downwash}
    document = {world.name: {WORLD: settings, VEHICLES: vehicles}}

    def write(target: Path) -> None:
        with target.open("w", encoding="utf-8") as file:
            YAML().dump(document, file)

    return write_atomically(path, write)


def _validated(model: type[_AnyModel], tree: Tree, path: str) -> _AnyModel:
    """Validate the fields at a path. Messages begin with the path, after file and line."""
    if not isinstance(tree.value, dict):
        raise InputError(f"{tree.mark}: {path} must be a mapping of fields")
    try:
        return validate(model, tree)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _fields(part: Tree, vehicle: str) -> Mapping[str, Tree]:
    """Return the fields of a vehicle; an empty mapping if the file gives none."""
    if part.value is None:
        return {}
    if not isinstance(part.value, dict):
        raise InputError(f"{part.mark}: vehicles.{vehicle} must be a mapping of fields, such as offset or route")
    return part.value
