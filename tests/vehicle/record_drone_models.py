"""Write `drone_models.json`: derivatives of the state of Crazyflies by the package drone-models.

`test_drone_models.py` reads the file. The script needs a separate environment, because the package requires CasADi:

    pip install drone-models==0.1.0
    python tests/vehicle/record_drone_models.py

The script evaluates the model `first_principles` of the package (utiasDSL, MIT licence) in random states. The
parameters of the drones are those of its data/params.toml, with rotor speeds in rpm. States and derivatives are in SI
units.
"""

import importlib.metadata
import json
import tomllib
from pathlib import Path

import drone_models
import numpy as np
from drone_models.first_principles import dynamics
from scipy.spatial.transform import Rotation

DRONES = ("cf2x_L250", "cf21B_500")
PARAMETERS = (
    *("mass", "L", "prop_inertia", "gravity_vec", "J", "rpm2thrust", "rpm2torque", "mixing_matrix", "drag_matrix"),
    "rotor_dyn_coef",
)
NUM_STATES = 25  # number of random states that are recorded for each drone
RPM = 2.0 * np.pi / 60.0  # one revolution per minute, rad/s


def main() -> None:
    tables = tomllib.loads((Path(drone_models.__file__).parent / "data" / "params.toml").read_text(encoding="utf-8"))
    rng = np.random.default_rng(23)
    drones = {}
    for drone in DRONES:
        numbers = {name: tables[drone][name] for name in PARAMETERS}
        drones[drone] = {"numbers": numbers, "samples": [sample(rng, numbers) for _ in range(NUM_STATES)]}
    record = {"package": f"drone-models {importlib.metadata.version('drone-models')}", "drones": drones}
    text = json.dumps(record, indent=1).replace("\n     ", "").replace("\n    ]", "]")
    Path(__file__).with_name("drone_models.json").write_text(text + "\n", encoding="utf-8")


def sample(rng: np.random.Generator, numbers: dict) -> dict:
    """Return a random state, random commanded rotor speeds, and the package's derivatives of the state."""
    attitude = rng.uniform(-1.2, 1.2, 3) * [1.0, 1.0, 2.5]
    velocity, rates = 2.0 * rng.normal(size=3), 5.0 * rng.normal(size=3)
    speeds, commands = rng.uniform(900.0, 2500.0, (2, 4))
    arrays = {name: np.array(value) for name, value in numbers.items()}
    _, _, acceleration, angular_acceleration, rotor_acceleration = dynamics(
        np.zeros(3),
        Rotation.from_euler("ZYX", attitude[::-1]).as_quat(),
        velocity,
        rates,
        commands / RPM,
        speeds / RPM,
        J_inv=np.linalg.inv(arrays["J"]),
        **arrays,
    )
    rows = {
        "attitude": attitude,
        "velocity": velocity,
        "rates": rates,
        "speeds": speeds,
        "commands": commands,
        "acceleration": acceleration,
        "turning": angular_acceleration,
        "spinning": rotor_acceleration * RPM,
    }
    return {name: row.tolist() for name, row in rows.items()}


if __name__ == "__main__":
    main()
