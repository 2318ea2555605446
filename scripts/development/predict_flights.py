"""Predict the RMS errors of the published Neural-Fly flights in wind, and print a table.

The script simulates the controller of the flights (`diagrams/vehicles/neural_fly.yaml`) in five winds, with all
modelled effects and without some of them. The table compares the RMS errors of the flights with those of the
simulations. Both use positions that cameras measure.

The phase of the sinusoidal wind was identified from the log of the flight (`--log`). The line below the table states
how much the error depends on this phase.
"""

import math
from pathlib import Path

from drake_quad.command_line.running import run

import numpy as np
import scipy

from drake_quad import Flight, load_scenario, read_log, simulate
from drake_quad.command_line.options import parser_without_options
from drake_quad.flight.simulation import simulate_batch, simulate_samples
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.effects.body_drag import BodyDragEffect
from drake_quad.scenario.winds.sine import SineSource
from drake_quad.scenario.winds.steady import SteadySource

_DIAGRAMS = Path(__file__).parents[2] / "diagrams"
_VEHICLE = _DIAGRAMS / "vehicles" / "neural_fly.yaml"
_LABORATORY = _DIAGRAMS / "neural_fly.yaml"
# Published RMS error (m) of the baseline controller over the last six laps (O'Connell et al., 2022), by scenario name.
PUBLISHED_ERRORS = {"still": 0.119, "wind_4": 0.107, "wind_8": 0.163, "wind_12": 0.239, "wind_8_sine": 0.312}
_WIND_LABELS = {
    "still": "0 m/s",
    "wind_4": "4.2 m/s",
    "wind_8": "8.5 m/s",
    "wind_12": "12.1 m/s",
    "wind_8_sine": "8.5 m/s and a sine",
}
_NUM_SAMPLES = 16  # flights per wind with noise and turbulence
_NUM_PHASES = 16  # phases of the sinusoidal wind
_NOMINAL_THRUST_CURVE = "vehicle.motors={kind: throttle, curve: [0.0, 14.27, 0.0]}"
_FAST_ATTITUDE = ("laboratory.autopilot.natural_frequency=[40, 40, 40]", "laboratory.autopilot.damping=[1, 1, 1]")
# Overrides for a drag that is equal in all directions, and was fitted to the same residual forces.
_ISOTROPIC_DRAG = (
    "vehicle.body_drag=null",
    "vehicle.rotor_aerodynamics=null",
    "vehicle.linear_drag=0.357",
    "vehicle.quadratic_drag=0.0732",
)
IDENTIFIED = "as identified"
VARIANTS: dict[str, tuple[str, ...]] = {
    IDENTIFIED: (),
    "without translational lift and climb": ("vehicle.rotor_aerodynamics=null",),
    "with the nominal thrust curve": (_NOMINAL_THRUST_CURVE,),
    "with an attitude without lag": _FAST_ATTITUDE,
    "with isotropic drag": _ISOTROPIC_DRAG,
    "with isotropic drag and the nominal thrust curve": (*_ISOTROPIC_DRAG, _NOMINAL_THRUST_CURVE),
}


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/development/predict_flights.py")
    options.add_argument(
        "--wind", choices=PUBLISHED_ERRORS, nargs="+", default=[*PUBLISHED_ERRORS], help="winds (default: all)"
    )
    options.add_argument(
        "--log",
        type=Path,
        help="log of a flight (custom_figure8_baseline_70p20sint.csv) from which to identify the sinusoidal wind",
    )
    arguments = options.parse_args()
    winds = arguments.wind
    print(f"| RMSE, cm | {' | '.join(_WIND_LABELS[wind] for wind in winds)} |")
    print(f"|{'---|' * (len(winds) + 1)}")
    flown = [PUBLISHED_ERRORS[wind] for wind in winds]
    print_row("flown", flown)
    for name, overrides in VARIANTS.items():
        errors = predicted(winds, overrides)
        print_row(name, errors)
        if name == IDENTIFIED:
            print_differences(errors, flown)
            print_row("as identified, true positions", predicted(winds, measured=False))
    print_row(f"with noise and turbulence, {_NUM_SAMPLES} flights", predicted_in_laboratory(winds))
    print()
    print_phases()
    if arguments.log is not None:
        print_log(arguments.log)


def predicted(winds: list[str], overrides: tuple[str, ...] = (), *, measured: bool = True) -> list[float]:
    """Return the predicted RMS errors of the flights in the given winds, m.

    Args:
        winds: names of the winds.
        overrides: overrides of the vehicle.
        measured: True to compute errors from measured positions; False to compute them from true positions.
    """
    flights = [simulate(load_scenario(f"{_VEHICLE}:{wind}", overrides)) for wind in winds]
    return [measured_rmse(flight) if measured else float(flight.metrics.rmse) for flight in flights]


def predicted_in_laboratory(winds: list[str]) -> list[float]:
    """Return the mean predicted RMS errors of the flights in the given winds, with noise and turbulence, m."""
    scenarios = (load_scenario(f"{_LABORATORY}:{wind}") for wind in winds)
    fleets = (simulate_samples(scenario, range(_NUM_SAMPLES)) for scenario in scenarios)
    return [float(np.mean([measured_rmse(flight) for flight in flights])) for flights in fleets]


def measured_rmse(flight: Flight) -> float:
    """Return the RMS error of the measured positions in the metric window, m.

    A log only contains measured positions, whereas `flight.metrics.rmse` is the error of the true positions.
    """
    measured, reference = flight.record("measurement"), flight.record("reference")
    counted = flight.time >= flight.scenario.metrics.start
    errors = [np.asarray(getattr(measured, axis) - getattr(reference, axis))[counted] for axis in ("x", "y", "z")]
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=0))))


def print_row(name: str, errors: list[float]) -> None:
    """Print a row of the table; errors are in m."""
    print(f"| {name} | {' | '.join(f'{100.0 * error:.1f}' for error in errors)} |")


def print_differences(errors: list[float], flown: list[float]) -> None:
    """Print the differences of the predicted errors from the errors of the flights in %."""
    fractions = [100.0 * (error / actual - 1.0) for error, actual in zip(errors, flown, strict=True)]
    print(f"| difference from the flights | {' | '.join(f'{fraction:+.0f} %' for fraction in fractions)} |")


def print_phases() -> None:
    """Print the smallest and the largest predicted error over all phases of the sinusoidal wind."""
    phases = np.linspace(0.0, 2.0 * math.pi, _NUM_PHASES, endpoint=False)
    batch = Batch.draw(load_scenario(f"{_VEHICLE}:wind_8_sine"), [0] * _NUM_PHASES)
    flights = simulate_batch(batch.with_varying({"laboratory.wind.1.phase": phases}))
    errors = [measured_rmse(flight) for flight in flights]
    low, high = int(np.argmin(errors)), int(np.argmax(errors))
    print(
        f"phase of the sine: {100.0 * errors[low]:.1f} cm at {phases[low]:.2f} rad to {100.0 * errors[high]:.1f} cm at"
        f" {phases[high]:.2f} rad"
    )


def print_log(path: Path) -> None:
    """Estimate the sinusoidal wind from a log, and print it with the RMSE that is predicted for this wind."""
    amplitude, phase = sine_in_log(path)
    sine = {"laboratory.wind.1.phase": phase, "laboratory.wind.1.velocity": [-amplitude, 0.0, 0.0]}
    error = measured_rmse(simulate(load_scenario(f"{_VEHICLE}:wind_8_sine", sine)))
    print(f"{path.name}: {amplitude:.2f} m/s and {phase:.2f} rad, predicted RMSE {100.0 * error:.1f} cm")


def sine_in_log(path: Path) -> tuple[float, float]:
    """Return the amplitude (m/s) and phase (rad) of a sinusoidal wind, estimated from the residual force in a log.

    The least-squares fit over the last six laps models the force along the body's x axis as the vehicle's drag plus a
    constant. As in the scenario, the wind's phase is relative to that of the reference x = 1.25 sin t.
    """
    record = read_log(path)
    scenario = load_scenario(f"{_VEHICLE}:wind_8_sine")
    steady, sine = scenario.laboratory.wind
    drag = scenario.vehicle.effects()["body_drag"]
    assert isinstance(sine, SineSource)
    assert isinstance(steady, SteadySource)
    assert isinstance(drag, BodyDragEffect)
    counted = record.time >= scenario.metrics.start
    time = sine.frequency * record.time[counted]
    waves = np.column_stack([np.sin(time), np.cos(time)])
    into_body = scipy.spatial.transform.Rotation.from_euler("ZYX", record.of("attitude")[counted, ::-1]).inv()
    force = into_body.apply(record.of("residual_force")[counted])[:, 0]
    velocity, direction = record.of("velocity")[counted], np.array([-1.0, 0.0, 0.0])

    def residuals(unknowns: np.ndarray) -> np.ndarray:
        air = steady.velocity + (waves @ unknowns[:2])[:, np.newaxis] * direction
        relative = into_body.apply(air - velocity)
        size = np.linalg.norm(relative, axis=1)
        return np.asarray((drag.linear[0] + drag.quadratic[0] * size) * relative[:, 0] + unknowns[2] - force)

    wind = scipy.optimize.least_squares(residuals, [1.0, 1.0, 0.0]).x[:2]
    along = record.of("reference_position")[counted, 0]
    reference = np.linalg.lstsq(np.column_stack([waves, np.ones(len(time))]), along, rcond=None)[0][:2]
    return float(np.hypot(*wind)), (_phase(wind) - _phase(reference)) % (2.0 * math.pi)


def _phase(weights: np.ndarray) -> float:
    """Return the phase (rad) of a sinusoid, given the coefficients of sin and cos."""
    sine, cosine = weights
    return math.atan2(cosine, sine)


if __name__ == "__main__":
    run(main)
