"""Geometric attitude control on SO(3): from the rotation error to a torque, without singularities."""

from typing import NamedTuple

from drake_quad.control.attitude import AttitudeParameters, attitude_inputs
from drake_quad.control.integral import Integration
from drake_quad.framework.elementary import maximum, minimum
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.geometry.axes import BodyAxes, Vector, cross
from drake_quad.geometry.kinematics import euler_torque
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.signals import AngularAcceleration, Attitude, BodyAccelerationB, BodyRates, State, Torque


class IntegratingAttitudeParameters(NamedTuple):
    """Parameters of an `IntegratingAttitudeController`.

    Attributes:
        attitude: gains and inertia.
        k_i: gains on the integrated error about each axis, 1/s³.
        limit: largest absolute value of the integral on each axis.
    """

    attitude: AttitudeParameters
    k_i: PerAngle
    limit: BodyAccelerationB


def _target_axes(measurement: State, attitude: Attitude) -> BodyAxes:
    """Return Rᵀ R_d, the axes of the commanded attitude along the axes of the measured attitude."""
    body = BodyAxes.of(measurement.roll, measurement.pitch, measurement.yaw)
    return BodyAxes(*(body.in_body(axis) for axis in BodyAxes.of(*attitude)))


def _rotation_error(target_axes: BodyAxes) -> Vector:
    """Return the rotation error ½ (R_dᵀ R - Rᵀ R_d)^∨, which follows from the antisymmetric part of Rᵀ R_d."""
    return Vector(
        0.5 * (target_axes.z.y - target_axes.y.z),
        0.5 * (target_axes.x.z - target_axes.z.x),
        0.5 * (target_axes.y.x - target_axes.x.y),
    )


def geometric_law(
    measurement: State,
    attitude: Attitude,
    rates: BodyRates,
    acceleration: AngularAcceleration,
    parameters: AttitudeParameters,
    transports: bool = True,
    integral: AngularAcceleration | None = None,
) -> Torque:
    """Return the torque of a `GeometricAttitudeController`.

    Args:
        measurement: measured state of the vehicle.
        attitude: commanded attitude.
        rates: commanded body rates along the axes of the commanded attitude.
        acceleration: commanded angular acceleration along the same axes.
        parameters: gains and inertia.
        transports: True if the law contains the transport term Ω̂ Rᵀ R_d Ω_d.
        integral: integral that is subtracted from the angular acceleration; None without an integral.
    """
    k_p, k_d, *inertia = parameters
    target_axes = _target_axes(measurement, attitude)
    error = _rotation_error(target_axes)
    measured_rates = Vector(measurement.p, measurement.q, measurement.r)
    target_rates, target_acceleration = (
        target_axes.in_world(Vector(*rates)),
        target_axes.in_world(Vector(*acceleration)),
    )
    total = [
        -k * e - d * (w - w_d) for k, d, e, w, w_d in zip(k_p, k_d, error, measured_rates, target_rates, strict=True)
    ]
    if transports:
        # The commanded rates are constant in the commanded frame. Their components along the body axes change, because
        # the body rotates relative to the commanded frame.
        transport = cross(measured_rates, target_rates)
        total = [value - term for value, term in zip(total, transport, strict=True)]
    total = [value + w_dot for value, w_dot in zip(total, target_acceleration, strict=True)]
    if integral is not None:
        total = [value - term for value, term in zip(total, integral, strict=True)]
    return euler_torque(AngularAcceleration(*total), BodyRates(*measured_rates), *inertia)


def integrating_law(
    integral: AngularAcceleration,
    measurement: State,
    attitude: Attitude,
    rates: BodyRates,
    acceleration: AngularAcceleration,
    parameters: IntegratingAttitudeParameters,
    transports: bool = True,
    period: float = 0.0,
) -> Torque:
    """Return the torque of an `IntegratingAttitudeController`: `geometric_law` minus I times the integral.

    If `period` (s) is positive, the error of this tick is first added to the integral by `integrated_rotation`, as
    backward Euler requires.
    """
    if period > 0.0:
        integral = integrated_rotation(integral, measurement, attitude, parameters, period)
    return geometric_law(measurement, attitude, rates, acceleration, parameters.attitude, transports, integral)


def integrated_rotation(
    integral: AngularAcceleration,
    measurement: State,
    attitude: Attitude,
    parameters: IntegratingAttitudeParameters,
    period: float,
) -> AngularAcceleration:
    """Return the integral after adding the rotation error of one tick of the given period (s)."""
    error = _rotation_error(_target_axes(measurement, attitude))
    return AngularAcceleration._make(
        maximum(minimum(before + period * k_i * e, parameters.limit), -parameters.limit)
        for before, k_i, e in zip(integral, parameters.k_i, error, strict=True)
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

    R_d is the rotation of `attitude_command`. Ω_d is `body_rate_command` and Ω̇_d is `angular_acceleration_command`,
    both along the axes of the commanded attitude. Ω̇_d is zero if its port is not connected. R and Ω are measured. The
    errors are

        e_R = ½ (R_dᵀ R - Rᵀ R_d)^∨,    e_Ω = Ω - Rᵀ R_d Ω_d

    The law converges from almost any attitude (T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking control of a
    quadrotor UAV on SE(3)", CDC 2010, eqs (10), (11), (16)). The gains k_R and k_Ω of the paper are k_P I and k_D I
    here, so that k_P and k_D apply to a double integrator. Near the commanded attitude the law equals a PD on roll,
    pitch and yaw. The transport term with Ω̂ accounts for the rotation of the body relative to the commanded axes. It
    can be omitted, as in the Crazyflie's firmware.

    The only parameter of the context is `parameters`.

    Args:
        num_vehicles: number of vehicles N.
        transports: True if the law contains the transport term Ω̂ Rᵀ R_d Ω_d.
        parameters: gains, and the inertia of the nominal vehicle.
    """

    def declare(self, *, transports: bool = True, parameters: AttitudeParameters) -> None:
        """Declare the ports, states and parameters of this system."""
        self.output("torque", geometric_law, *attitude_inputs(self), transports)


@fleet_system(float, AutoDiffXd)
class IntegratingAttitudeController(FleetSystem):
    """Geometric attitude control with an integral i: the torque of a `GeometricAttitudeController` minus I i.

    .. pydrake_system::

        name: IntegratingAttitudeController
        input_ports:
        - measurement
        - attitude_command
        - body_rate_command
        - angular_acceleration_command
        output_ports:
        - torque

    At every tick i⁺ = i + h k_I e_R about each axis of B, saturated at plus and minus the limit. With the integration
    `backward_euler` the torque contains -I i⁺ instead of -I i. The integral compensates constant torques, for example
    due to an offset of the centre of mass or to unequal rotors.

    F. Goodarzi, D. Lee and T. Lee, "Geometric nonlinear PID control of a quadrotor UAV on SE(3)", ECC 2013, integrate
    e_Ω + c e_R. The Crazyflie's firmware integrates e_R by backward Euler, without a limit.

    The only state is `integral`; the only parameter of the context is `parameters`.

    Args:
        num_vehicles: number of vehicles N.
        period: tick period h, s.
        integration: "forward_euler" or "backward_euler".
        transports: True if the law contains the transport term Ω̂ Rᵀ R_d Ω_d.
        parameters: gains, and the inertia of the nominal vehicle.
    """

    def declare(
        self,
        *,
        period: float = 0.02,
        integration: Integration = "forward_euler",
        transports: bool = True,
        parameters: IntegratingAttitudeParameters,
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        measurement, attitude, rates, acceleration, parameter = attitude_inputs(self)
        integral = self.state("integral", lambda _: AngularAcceleration(0.0, 0.0, 0.0))
        before = integral, measurement, attitude, parameter
        self.update(period, integrated_rotation, *before, period, writes=[integral])
        reads = integral, measurement, attitude, rates, acceleration, parameter
        self.output("torque", integrating_law, *reads, transports, period if integration == "backward_euler" else 0.0)
