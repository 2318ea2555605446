"""The inner loop on SO(3): from the error of the rotation to torques, without a singularity."""

from typing import NamedTuple

from drake_quad.axes import BodyAxes, Vector, cross
from drake_quad.control.attitude import AttitudeNumbers, torque_of
from drake_quad.control.axes import PerAngle
from drake_quad.framework.elementary import maximum, minimum
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.signals import AngularAcceleration, Attitude, BodyAccelerationB, BodyRates, State, Torque


class IntegratingAttitudeNumbers(NamedTuple):
    """Numbers of an `IntegratingAttitudeController`.

    Attributes:
        attitude: gains and inertia.
        k_i: on the error of each angle, 1/s³.
        limit: of what the integral adds on each axis.
    """

    attitude: AttitudeNumbers
    k_i: PerAngle
    limit: BodyAccelerationB


def _turned(measurement: State, attitude: Attitude) -> BodyAxes:
    """Rᵀ R_d: the axes of the commanded attitude as they are seen from the body."""
    body = BodyAxes.of(measurement.roll, measurement.pitch, measurement.yaw)
    return BodyAxes(*(body.in_body(axis) for axis in BodyAxes.of(*attitude)))


def _rotation_error(turned: BodyAxes) -> Vector:
    """e_R = ½ (R_dᵀ R - Rᵀ R_d)^∨, what is not symmetric of Rᵀ R_d."""
    return Vector(0.5 * (turned.z.y - turned.y.z), 0.5 * (turned.x.z - turned.z.x), 0.5 * (turned.y.x - turned.x.y))


def _wanted(
    measurement: State,
    attitude: Attitude,
    rates: BodyRates,
    acceleration: AngularAcceleration,
    k_p: PerAngle,
    k_d: PerAngle,
) -> AngularAcceleration:
    """-k_P e_R - k_D e_Ω - Ω̂ Rᵀ R_d Ω_d + Rᵀ R_d Ω̇_d; arguments as for `geometric_law`, and gains."""
    turned = _turned(measurement, attitude)
    error = _rotation_error(turned)
    own = Vector(measurement.p, measurement.q, measurement.r)
    commanded, faster = turned.in_world(Vector(*rates)), turned.in_world(Vector(*acceleration))
    # How the commanded rates turn as they are seen from the body.
    carried = cross(own, commanded)
    return AngularAcceleration._make(
        -k * e - d * (w - w_d) - turn + w_dot
        for k, d, e, w, w_d, turn, w_dot in zip(k_p, k_d, error, own, commanded, carried, faster, strict=True)
    )


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
    wanted = _wanted(measurement, attitude, rates, acceleration, k_p, k_d)
    return torque_of(wanted, BodyRates(measurement.p, measurement.q, measurement.r), *inertia)


def integrating_law(
    integral: AngularAcceleration,
    measurement: State,
    attitude: Attitude,
    rates: BodyRates,
    acceleration: AngularAcceleration,
    numbers: IntegratingAttitudeNumbers,
) -> Torque:
    """The torque of an `IntegratingAttitudeController`: that of `geometric_law`, less I times the integral."""
    k_p, k_d, *inertia = numbers.attitude
    without = _wanted(measurement, attitude, rates, acceleration, k_p, k_d)
    wanted = AngularAcceleration._make(whole - held for whole, held in zip(without, integral, strict=True))
    return torque_of(wanted, BodyRates(measurement.p, measurement.q, measurement.r), *inertia)


def integrated_rotation(
    integral: AngularAcceleration,
    measurement: State,
    attitude: Attitude,
    numbers: IntegratingAttitudeNumbers,
    period: float,
) -> AngularAcceleration:
    """The integral a tick (s) later."""
    error = _rotation_error(_turned(measurement, attitude))
    return AngularAcceleration._make(
        maximum(minimum(before + period * k_i * e, numbers.limit), -numbers.limit)
        for before, k_i, e in zip(integral, numbers.k_i, error, strict=True)
    )


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


def _nothing(numbers: IntegratingAttitudeNumbers) -> AngularAcceleration:
    return AngularAcceleration(0.0, 0.0, 0.0)


@fleet_system(float, AutoDiffXd)
class IntegratingAttitudeController(FleetSystem):
    """Geometric attitude control with an integral: the torque of a `GeometricAttitudeController`, less I i.

    .. pydrake_system::

        name: IntegratingAttitudeController
        input_ports:
        - measurement
        - attitude_command
        - body_rate_command
        - angular_acceleration_command
        output_ports:
        - torque

    At every tick i⁺ = i + h k_I e_R about each axis of B, held between plus and minus the limit. It holds what turns
    the vehicle for long: a centre of mass beside the middle, rotors that are unlike. (F. Goodarzi, D. Lee and T. Lee,
    "Geometric nonlinear PID control of a quadrotor UAV on SE(3)", ECC 2013, integrates e_Ω + c e_R; the Crazyflie's
    firmware integrates e_R, as this does.)

    The only state is `integral`, the only parameter of the context `numbers`.

    Args:
        num_vehicles: N.
        period: h of the ticks, s.
        numbers: gains, and the inertia that is believed.
    """

    def declare(self, *, period: float = 0.02, numbers: IntegratingAttitudeNumbers) -> None:
        """Declares the system."""
        parameter = self.parameter("numbers", lambda numbers: numbers)
        measurement, attitude = self.input("measurement"), self.input("attitude_command")
        rates = self.input("body_rate_command")
        acceleration = self.input("angular_acceleration_command", absent=AngularAcceleration(0.0, 0.0, 0.0))
        integral = self.state("integral", _nothing)
        before = integral, measurement, attitude, parameter
        self.update(period, integrated_rotation, *before, period, writes=[integral])
        self.output("torque", integrating_law, integral, measurement, attitude, rates, acceleration, parameter)
