"""Parameters of the nominal vehicle, the model that planner and controllers use."""

from drake_quad.framework.records import record_like
from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.models import Mission, Nominal
from drake_quad.vehicle.motors import mean_thrust_factor, speed_range_of_throttles
from drake_quad.vehicle.parameters import QuadrotorParameters

_DEFAULT_VALUES = QuadrotorParameters._field_defaults


def nominal_parameters(mission: Mission) -> QuadrotorParameters:
    """Return the parameters of the nominal vehicle.

    The nominal vehicle has no drag, and its centre of mass is the origin of the rotor layout.
    """
    defaults = {name: value for name, value in _DEFAULT_VALUES.items() if name not in Nominal.model_fields}
    return record_like(QuadrotorParameters, mission.nominal, **defaults | {"rotors": rotors_of(mission.nominal)})


def planned_parameters(mission: Mission) -> QuadrotorParameters:
    """Return `nominal_parameters` with rotor speeds limited to the range of the nominal throttle curve."""
    parameters, curve = nominal_parameters(mission), mission.nominal.motors.thrust_curve()
    if curve is None:
        return parameters
    slowest, fastest = speed_range_of_throttles(curve, mean_thrust_factor(parameters))
    return parameters._replace(
        min_rotor_speed=max(parameters.min_rotor_speed, slowest),
        max_rotor_speed=min(parameters.max_rotor_speed, fastest),
    )
