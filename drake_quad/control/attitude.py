"""Attitude control (inner loop): from the attitude error to a torque."""

from typing import Annotated, Any, NamedTuple

from drake_quad.framework.elementary import wrap_angle
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.kinematics import euler_torque
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.signals import AngularAcceleration, Attitude, BodyRates, Quantity, Row, State, Torque

MomentOfInertia = Annotated[Row, Quantity("kg m²", "B")]


class AttitudeParameters(NamedTuple):
    """Attitude controller gains, and moments of inertia of the nominal vehicle.

    Attributes:
        k_p: gains on the error of each angle, 1/s².
        k_d: gains on the errors of the body rates, 1/s.
        i_xx: moment of inertia about x_B, kg m².
        i_yy: moment of inertia about y_B, kg m².
        i_zz: moment of inertia about z_B, kg m².
    """

    k_p: PerAngle
    k_d: PerAngle
    i_xx: MomentOfInertia
    i_yy: MomentOfInertia
    i_zz: MomentOfInertia


def pd_angular_acceleration(
    measurement: State,
    attitude: Attitude,
    rates: BodyRates,
    acceleration: AngularAcceleration,
    k_p: PerAngle,
    k_d: PerAngle,
) -> AngularAcceleration:
    """Return the angular acceleration k_P e + k_D ė + ω̇_r that an `AttitudeController` commands.

    Args:
        measurement: measured state of the vehicle.
        attitude: commanded attitude.
        rates: commanded body rates.
        acceleration: commanded angular acceleration.
        k_p: gains on the error of each angle, 1/s².
        k_d: gains on the errors of the body rates, 1/s.
    """
    p_r, q_r, r_r = rates
    roll = k_p.roll * (attitude.roll - measurement.roll) + k_d.roll * (p_r - measurement.p)
    pitch = k_p.pitch * (attitude.pitch - measurement.pitch) + k_d.pitch * (q_r - measurement.q)
    yaw = k_p.yaw * wrap_angle(attitude.yaw - measurement.yaw) + k_d.yaw * (r_r - measurement.r)
    return AngularAcceleration(roll + acceleration.p, pitch + acceleration.q, yaw + acceleration.r)


def attitude_law(
    measurement: State,
    attitude: Attitude,
    rates: BodyRates,
    acceleration: AngularAcceleration,
    parameters: AttitudeParameters,
) -> Torque:
    """Return the torque of an `AttitudeController`; the arguments are as in `pd_angular_acceleration`."""
    k_p, k_d, *inertia = parameters
    commanded = pd_angular_acceleration(measurement, attitude, rates, acceleration, k_p, k_d)
    return euler_torque(commanded, rates, *inertia)


def attitude_inputs(system: FleetSystem) -> tuple[Any, Any, Any, Any, Any]:
    """Declare the input ports and the context parameter `parameters` of an attitude controller.

    Returns:
        Ports for measurement, attitude, body rates and angular acceleration (zero if not connected), and the parameter.
    """
    return (
        system.input("measurement"),
        system.input("attitude_command"),
        system.input("body_rate_command"),
        system.input("angular_acceleration_command", absent=AngularAcceleration(0.0, 0.0, 0.0)),
        system.parameter("parameters", lambda parameters: parameters),
    )


@fleet_system(float, AutoDiffXd)
class AttitudeController(FleetSystem):
    """PD on roll, pitch and yaw with feed-forward: τ = I (k_P e + k_D ė + ω̇_r) + ω_r × I ω_r in B.

    .. pydrake_system::

        name: AttitudeController
        input_ports:
        - measurement
        - attitude_command
        - body_rate_command
        - angular_acceleration_command
        output_ports:
        - torque

    e is `attitude_command` minus the measured attitude, with the yaw error in [-π, π]. ė is `body_rate_command` ω_r
    minus the measured body rates. ω̇_r is `angular_acceleration_command`, zero if not connected. The angular
    acceleration k_P e + k_D ė + ω̇_r is multiplied by the moments of inertia. The gains therefore apply to a double
    integrator and do not depend on the vehicle.

    The only parameter of the context is `parameters`.

    Args:
        num_vehicles: number of vehicles N.
        parameters: gains, and the inertia of the nominal vehicle.
    """

    def declare(self, *, parameters: AttitudeParameters) -> None:
        """Declare the ports, states and parameters of this system."""
        self.output("torque", attitude_law, *attitude_inputs(self))
