"""Chooses how a vehicle is identified by what logs hold."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.identification import rotor_identification
from drake_quad.identification.fitting.forecast import Forecast
from drake_quad.identification.fitting.open_loop import DELAY, delay_of
from drake_quad.identification.fitting.windows import airborne
from drake_quad.identification.force_identification import identify_forces, tells_forces
from drake_quad.identification.identified import Fitted, Identification, Spread
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.response_identification import identify_attitude_response, identify_from_poses
from drake_quad.identification.results.estimates import Estimates
from drake_quad.identification.results.held_out import hold_out
from drake_quad.identification.results.vehicle_numbers import with_estimates, with_numbers, with_throttles
from drake_quad.scenario.models import Scenario
from drake_quad.vehicle.rigid_body import inertia_flaw

# In the air, s, for windows in which a filter settles; shorter flights need shorter windows.
_LONG = 30.0
_UNITS = {"position": "m", "specific": "m/s²", "body": "rad/s"}


def identify(
    records: Sequence[FlightRecord], scenario: Scenario, *, held_out_share: float = 1.0 / 3.0
) -> Identification:
    """Identify a vehicle from flight logs.

    The method depends on the signals in the logs:

    - Behind an autopilot that logs the residual force: attitude response and forces
      (`drake_quad.identification.force_identification`).
    - With rotor commands, and an accelerometer or half a minute of poses: prediction errors
      (`drake_quad.identification.rotor_identification`).
    - Behind another autopilot, in short flights, and without attitude: multiple shooting
      (`drake_quad.identification.response_identification`).

    Args:
        records: records of flights of the same vehicle.
        scenario: scenario without distributions, with the initial values. Parameters that the logs do not identify
            keep these values.
        held_out_share: share of the airborne time, at the end of each log, that is held out for validation.

    Raises:
        InputError: no log is given, a log lacks a signal, the flights are too short, or the logged values are
            physically impossible.
    """
    if not records:
        raise InputError("there is no log to identify a vehicle from")
    try:
        found = _identified(records, scenario, held_out_share)
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"the logs cannot be fitted ({error}): their values are not those of a flying vehicle; check the units in"
            " the mapping"
        ) from error
    flaw = inertia_flaw(found.vehicle.vehicle.inertia)
    remarks = [f"the identified inertia is not that of a rigid body, because of its error: {flaw}"] if flaw else []
    return replace(found, remarks=(*found.remarks, *remarks))


def _identified(records: Sequence[FlightRecord], scenario: Scenario, held_out_share: float) -> Identification:
    """Identify a vehicle with the method that suits the signals of the logs; arguments are those of `identify`."""
    responds = scenario.laboratory.autopilot.models_vehicle
    if responds and all(map(tells_forces, records)):
        return _from_attitudes_and_forces(records, scenario, held_out_share)
    if responds or not _by_prediction_errors(records):
        return identify_from_poses(records, scenario, held_out_share=held_out_share)
    if any(record.motor_command is not None for record in records):
        scenario = with_throttles(scenario)
    return _translated(rotor_identification.identify(records, scenario, share=held_out_share), scenario, records)


def _from_attitudes_and_forces(
    records: Sequence[FlightRecord], scenario: Scenario, held_out_share: float
) -> Identification:
    """The answer of the attitude first, whose delay is that of the thrust, too; then the forces in it."""
    turning = identify_attitude_response(records, scenario, held_out_share=held_out_share)
    deviation = 0.0 if turning.delay is None else turning.delay.deviation
    forces = identify_forces(records, turning.vehicle, delay_deviation=deviation, held_out_share=held_out_share)
    estimates = _joined(turning.estimates, forces.estimates)
    return Identification(
        estimates,
        with_estimates(turning.vehicle, estimates),
        (*forces.outputs, *turning.outputs),
        turning.delay,
        {**forces.further, **(turning.further or {})},
        (*turning.remarks, *forces.remarks),
        turning.held_out,
    )


def _by_prediction_errors(records: Sequence[FlightRecord]) -> bool:
    if all(record.specific_force is not None and record.body_rates is not None for record in records):
        return True
    poses = all(record.position is not None and record.attitude is not None for record in records)
    return poses and sum(float(airborne(record).sum()) * record.period for record in records) >= _LONG


def _translated(
    found: rotor_identification.RotorIdentification, scenario: Scenario, records: Sequence[FlightRecord]
) -> Identification:
    """The result of prediction errors."""
    vehicle, delay = with_estimates(scenario, found.estimates), None
    if found.delay is not None:
        delay = Spread(found.delay.value, found.delay.deviation, "s", found.delay.degrees_of_freedom)
        link = scenario.laboratory.command_link
        vehicle = with_numbers(vehicle, {DELAY: (delay.value - float(delay_of(scenario, 0.0))) / link.period})
    outputs = () if found.forecast is None else _series(found.forecast, found.noise.measured, records[0].name)
    told = {*found.estimates.names, rotor_identification.DELAY}
    covered = {name: each for name, each in hold_out(found.evidence).items() if name in told}
    return Identification(found.estimates, vehicle, outputs, delay, held_out=covered)


def _series(forecast: Forecast, deviations: np.ndarray, log: str) -> tuple[Fitted, ...]:
    """What was told of the end of the flights; windows stand one after another."""
    windows = forecast.measured.shape[2]
    length = float(forecast.time[-1])
    time = np.arange(windows)[:, None] * length + forecast.time
    return tuple(
        Fitted(
            name,
            _UNITS.get(name.split()[0], "rad"),
            np.array([log] * windows),
            time,
            forecast.measured[:, i].T,
            forecast.predicted[:, i].T,
            np.ones(windows, dtype=bool),
            float(forecast.explained[i]),
            np.nan,
            float(deviations[i]),
        )
        for i, name in enumerate(forecast.names)
    )


def _joined(first: Estimates, second: Estimates) -> Estimates:
    """Estimates of different numbers as one, without the correlation of errors of one part with those of the other.

    The error of the delay is in the deviations of the numbers of forces, not in a correlation with the delay.
    """
    parts = (first, second)
    return Estimates(
        tuple(name for part in parts for name in part.names),
        np.concatenate([part.values for part in parts]),
        scipy.linalg.block_diag(*(part.covariance for part in parts)),
        np.concatenate([np.asarray(part.degrees_of_freedom) for part in parts]),
        tuple(part.sources_of(i) for part in parts for i in range(len(part.names))),
        {name: share for part in parts for name, share in part.explained.items()},
        {name: why for part in parts for name, why in part.not_seen.items()},
        variation=None if first.variation is None else first.variation.beside(len(second.names)),
    )
