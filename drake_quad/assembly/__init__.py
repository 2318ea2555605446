"""From a scenario to a named diagram."""

from drake_quad.assembly.planning import flight_duration, nominal_parameters, plan_route
from drake_quad.assembly.tracking import build_fleet_diagram, build_tracking_diagram, reset_fleet
from drake_quad.assembly.user_systems import UserSystems

__all__ = [
    "UserSystems",
    "build_fleet_diagram",
    "build_tracking_diagram",
    "flight_duration",
    "nominal_parameters",
    "plan_route",
    "reset_fleet",
]
