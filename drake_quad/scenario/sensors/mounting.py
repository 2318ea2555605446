"""Position of a sensor on the vehicle."""

from typing import Any

from drake_quad.laboratory.sensors.mounting import SensorPosition


def relative_to_centre(position: Any, vehicle: Any) -> SensorPosition:
    """Return the position of a sensor relative to the true centre of mass, m.

    Args:
        position: x, y and z in B relative to the origin of the layout, m.
        vehicle: vehicle in `Batch.fleet_scenario`, in which random fields are arrays.
    """
    (x, y, z), (centre_x, centre_y) = position, vehicle.centre_of_mass
    return SensorPosition(x - centre_x, y - centre_y, z)
