"""Predicts the published flights of Neural-Fly in wind, with and without what the vehicle feels, and prints a table.

The law that was flown (`diagrams/vehicles/neural_fly.yaml`) flies in five winds; its RMS errors stand beside those of
the flights.
"""

import argparse
from pathlib import Path

from drake_quad.command_line.running import run

from drake_quad import load_scenario, simulate

_VEHICLE = Path(__file__).parent.parent / "diagrams" / "vehicles" / "neural_fly.yaml"
# RMS error over the last six laps with the baseline, m, by the scenario that flies it: O'Connell et al., 2022.
FLOWN = {"still": 0.119, "wind_4": 0.107, "wind_8": 0.163, "wind_12": 0.239, "wind_8_sine": 0.312}
_NO_CURVE = "vehicle.motors={kind: throttle, curve: [0.0, 14.27, 0.0]}"
_QUICK = ("laboratory.autopilot.natural_frequency=[40, 40, 40]", "laboratory.autopilot.damping=[1, 1, 1]")
# The same residual forces, fitted by a drag that is the same from all sides.
_ISOTROPIC = (
    "vehicle.body_drag=null",
    "vehicle.rotor_aerodynamics=null",
    "vehicle.linear_drag=0.357",
    "vehicle.quadratic_drag=0.0732",
)
VARIANTS: dict[str, tuple[str, ...]] = {
    "as identified": (),
    "without translational lift and climb": ("vehicle.rotor_aerodynamics=null",),
    "with the thrust curve that is believed": (_NO_CURVE,),
    "with an attitude that follows at once": _QUICK,
    "with isotropic drag": _ISOTROPIC,
    "with isotropic drag and the thrust curve that is believed": (*_ISOTROPIC, _NO_CURVE),
}


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__,
        epilog="example: python scripts/predict_flights.py",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.parse_args()
    print("| RMSE, cm | 0 m/s | 4.2 m/s | 8.5 m/s | 12.1 m/s | 8.5 + 2.4 sin t m/s |")
    print("|---|---|---|---|---|---|")
    print_row("flown", list(FLOWN.values()))
    for name, overrides in VARIANTS.items():
        print_row(name, predicted(overrides))


def predicted(overrides: tuple[str, ...] = ()) -> list[float]:
    """The RMS errors of the five flights, m, with a vehicle that some overrides change."""
    scenarios = (load_scenario(f"{_VEHICLE}:{name}", overrides) for name in FLOWN)
    return [float(simulate(scenario, compiled=True).metrics.rmse) for scenario in scenarios]


def print_row(name: str, errors: list[float]) -> None:
    """Prints a row of the table, given errors in m."""
    print(f"| {name} | {' | '.join(f'{100.0 * error:.1f}' for error in errors)} |")


if __name__ == "__main__":
    run(main)
