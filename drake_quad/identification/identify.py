"""Chooses how a vehicle is identified by what logs hold."""

from collections.abc import Sequence

import numpy as np

from drake_quad.errors import InputError
from drake_quad.identification import rotor_identification
from drake_quad.identification.fitting.forecast import Forecast
from drake_quad.identification.fitting.open_loop import DELAY, delay_of
from drake_quad.identification.fitting.windows import airborne
from drake_quad.identification.identified import Fitted, Identification, Spread
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.response_identification import identify_from_poses
from drake_quad.identification.results.vehicle_numbers import with_estimates, with_numbers, with_throttles
from drake_quad.scenario import Scenario
from drake_quad.scenario.autopilots import AttitudeResponse

# In the air, s, for windows in which a filter settles; shorter flights need shorter windows.
_LONG = 30.0
_UNITS = {"position": "m", "specific": "m/s²", "body": "rad/s"}


def identify(
    records: Sequence[FlightRecord], scenario: Scenario, *, held_out_share: float = 1.0 / 3.0
) -> Identification:
    """Identifies a vehicle from flight logs.

    By prediction errors (`drake_quad.identification.rotor_identification`) where rotors are commanded and there is an
    accelerometer, or half a minute of poses; by multiple shooting (`drake_quad.identification.response_identification`)
    behind an autopilot, in short flights, and without attitude.

    Args:
        records: of flights of the same vehicle.
        scenario: in numbers, to begin with; what the logs do not tell stays as it is.
        held_out_share: of the time in the air, at the end of each log, that is only predicted.

    Raises:
        InputError: there is no log, a log lacks a signal, or there is too little flight.
    """
    if not records:
        raise InputError("there is no log to identify a vehicle from")
    if isinstance(scenario.laboratory.autopilot, AttitudeResponse) or not _by_prediction_errors(records):
        return identify_from_poses(records, scenario, held_out_share=held_out_share)
    if any(record.motor_command is not None for record in records):
        scenario = with_throttles(scenario)
    return _translated(rotor_identification.identify(records, scenario, share=held_out_share), scenario, records)


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
        delay = Spread(found.delay.value, found.delay.deviation, "s")
        link = scenario.laboratory.command_link
        vehicle = with_numbers(vehicle, {DELAY: (delay.value - float(delay_of(scenario, 0.0))) / link.period})
    outputs = () if found.forecast is None else _series(found.forecast, found.noise.measured, records[0].name)
    return Identification(found.estimates, vehicle, outputs, delay)


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
