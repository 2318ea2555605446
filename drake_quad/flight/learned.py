"""Saving of the parameters that a network learned in a flight."""

from pathlib import Path

import numpy as np
from ruamel.yaml import YAML

from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_atomically
from drake_quad.flight.flight import Flight
from drake_quad.scenario.networks.learned import LearnedAxis, LearnedNetwork


def save_network(flight: Flight, path: Path | str) -> Path:
    """Save the parameters of a flight's network at the last tick: the weights and, if they are adapted, the fuzzy sets.

    In a scenario with `control.network.learned: FILE`, the networks of all vehicles start with these parameters.

    Args:
        flight: flight with a network.
        path: path of the YAML file.

    Returns:
        The path.

    Raises:
        InputError: if the flight has no network, a parameter is not finite, or the file cannot be written.
    """
    network = flight.scenario.control.network
    if network is None or "weights" not in flight.signals:
        raise InputError("the flight has no network to save")
    axes = sorted(network.axes)
    *_, last = flight["weights"]
    weights, antecedents = np.split(last, len(axes)), [None] * len(axes)
    if "antecedents" in flight.signals:
        *_, last = flight["antecedents"]
        antecedents = np.split(last, len(axes))
    if not np.isfinite(np.concatenate(weights)).all():
        raise InputError("the parameters of the network cannot be saved, since some are NaN or infinite")
    learned_axes = {
        axis: LearnedAxis(weights=tuple(f.tolist()), antecedents=None if sets is None else tuple(sets.tolist()))
        for axis, f, sets in zip(axes, weights, antecedents, strict=True)
    }
    networks_inputs = network.inputs.specified
    learned = LearnedNetwork(
        kind=network.kind,
        inputs=tuple(networks_inputs),
        sets=tuple([len(sets.centres) for sets in networks_inputs.values()]),
        **learned_axes,
    )
    target = Path(path)
    output_folder(target.parent)
    return write_atomically(target, lambda file: YAML().dump(learned.model_dump(mode="json", exclude_none=True), file))
