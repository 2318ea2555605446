"""Vehicle that the ground station knows: the parameters that plans and controllers use."""

from typing import Any

from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.models import Mission
from drake_quad.vehicle.motors import mean_thrust_factor, speeds_of_throttles
from drake_quad.vehicle.parameters import Inertia, QuadrotorParameters


def nominal_parameters(mission: Mission) -> QuadrotorParameters:
    """What is believed of the vehicle: no drag, the centre of mass in the middle of its layout."""
    return QuadrotorParameters()._replace(**airframe_parameters(mission.nominal))


def planned_parameters(mission: Mission) -> QuadrotorParameters:
    """`nominal_parameters`, where motors take throttles with the narrower limits of the believed thrust curve."""
    parameters, curve = nominal_parameters(mission), mission.nominal.motors.thrust_curve()
    if curve is None:
        return parameters
    slowest, fastest = speeds_of_throttles(curve, mean_thrust_factor(parameters))
    return parameters._replace(
        min_rotor_speed=max(parameters.min_rotor_speed, slowest),
        max_rotor_speed=min(parameters.max_rotor_speed, fastest),
    )


def airframe_parameters(airframe: Any) -> dict[str, Any]:
    """The parameters that an airframe of a scenario, or of a `Batch.fleet_scenario`, gives, by name."""
    return {
        "mass": airframe.mass,
        "inertia": Inertia(*airframe.inertia),
        "rotor_inertia": airframe.rotor_inertia,
        "rotors": rotors_of(airframe),
        "gravity": airframe.gravity,
        "min_rotor_speed": airframe.min_rotor_speed,
        "max_rotor_speed": airframe.max_rotor_speed,
    }
