"""The inner loop on SO(3): from the error of the rotation to torques, without a singularity."""

from drake_quad.axes import BodyAxes, Vector, cross
from drake_quad.control.attitude import AttitudeNumbers, torque_of
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import AngularAcceleration, Attitude, BodyRates, State, Torque


def geometric_law(
    measurement: State,
    attitude: Attitude,
    rates: BodyRates,
    acceleration: AngularAcceleration,
    numbers: AttitudeNumbers,
) -> Torque:
    """The torque of a `GeometricAttitudeController`.

    Args:
        measurement: of the vehicle's state.
        attitude: commanded.
        rates: commanded, along the axes of the commanded attitude.
        acceleration: commanded, along the same.
        numbers: gains and inertia.
    """
    k_p, k_d, *inertia = numbers
    body = BodyAxes.of(measurement.roll, measurement.pitch, measurement.yaw)
    # Rᵀ R_d, of which e_R = ½ (R_dᵀ R - Rᵀ R_d)^∨ is what is not symmetric.
    turned = BodyAxes(*(body.in_body(axis) for axis in BodyAxes.of(*attitude)))
    error = Vector(0.5 * (turned.z.y - turned.y.z), 0.5 * (turned.x.z - turned.z.x), 0.5 * (turned.y.x - turned.x.y))
    own = Vector(measurement.p, measurement.q, measurement.r)
    commanded, faster = turned.in_world(Vector(*rates)), turned.in_world(Vector(*acceleration))
    # How the commanded rates turn as they are seen from the body.
    carried = cross(own, commanded)
    wanted = AngularAcceleration._make(
        -k * e - d * (w - w_d) - turn + w_dot
        for k, d, e, w, w_d, turn, w_dot in zip(k_p, k_d, error, own, commanded, carried, faster, strict=True)
    )
    return torque_of(wanted, BodyRates(*own), *inertia)


@fleet_system(float, AutoDiffXd)
class GeometricAttitudeController(FleetSystem):
    """Geometric attitude control: τ = I (-k_P e_R - k_D e_Ω - Ω̂ Rᵀ R_d Ω_d + Rᵀ R_d Ω̇_d) + Ω × I Ω in B.

    .. pydrake_system::

        name: GeometricAttitudeController
        input_ports:
        - measurement
        - attitude_command
        - body_rate_command
        - angular_acceleration_command
        output_ports:
        - torque

    R_d is the rotation of `attitude_command`, along whose axes Ω_d, `body_rate_command`, and Ω̇_d,
    `angular_acceleration_command`, zero if not connected, are given; R and Ω are measured. With

        e_R = ½ (R_dᵀ R - Rᵀ R_d)^∨,    e_Ω = Ω - Rᵀ R_d Ω_d

    it brings the body home from almost any attitude (T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking control
    of a quadrotor UAV on SE(3)", CDC 2010, eqs (10), (11), (16)); their k_R and k_Ω are k_P I and k_D I here, so that
    gains are those of a double integrator. Near the commanded attitude it is the PD on roll, pitch and yaw.

    The only parameter of the context is `numbers`.

    Args:
        num_vehicles: N.
        numbers: gains, and the inertia that is believed.
    """

    def declare(self, *, numbers: AttitudeNumbers) -> None:
        """Declares the system."""
        parameter = self.parameter("numbers", lambda numbers: numbers)
        measurement, attitude = self.input("measurement"), self.input("attitude_command")
        rates = self.input("body_rate_command")
        acceleration = self.input("angular_acceleration_command", absent=AngularAcceleration(0.0, 0.0, 0.0))
        self.output("torque", geometric_law, measurement, attitude, rates, acceleration, parameter)
