"""Controllers: eqs (6) to (17), PID, feed-forward, and the variants of learning."""

import math

import numpy as np
import scipy

from oracle.vehicle import cross, euler_to_body, rotation


class LaggedResponse:
    """Delayed response of the acceleration to the two summands of a command. Each summand has its own lag.

    Args:
        ticks: delay in ticks.
        lags: time constants (summands, axes), s.
        h: tick period, s.
    """

    def __init__(self, ticks, lags, h):
        lags = np.array(lags, dtype=float)
        self.line, self.a = [np.zeros_like(lags)] * ticks, np.zeros_like(lags)
        # The state is (p, v, a, u) with p'' = a and T a' = u - a, where u is held.
        self.flow = np.zeros((*lags.shape, 4, 4))
        for index in np.ndindex(lags.shape):
            slope = np.diag([1.0, 1.0, 0.0], 1)
            slope[2, 2:] = [-1.0 / lags[index], 1.0 / lags[index]]
            slope[3] = 0.0
            self.flow[index] = scipy.linalg.expm(h * slope)

    def follow(self, *commands):
        """Send commands, and return the changes of velocity and position until the next tick."""
        self.line.append(np.array(commands))
        u = self.line.pop(0)
        state = np.stack([np.zeros_like(u), np.zeros_like(u), self.a, u], axis=-1)
        p, v, self.a, _ = np.moveaxis(np.einsum("...ij,...j", self.flow, state), -1, 0)
        return v.sum(axis=0), p.sum(axis=0)


class KalmanFilter:
    """Stationary Kalman filter of p' = v, v' = a + d, d' = -d / T + w, y = p + n on each axis.

    The gain is the limit of an iteration of the Riccati equation.
    """

    def __init__(self, parameters, h, start):
        self.h, self.models = h, []
        for sigma, T in zip(parameters.deviation, parameters.time_constant, strict=True):
            slope = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / T]])

            def noise_rate(s, slope=slope, intensity=2.0 * sigma**2 / T):
                column = scipy.linalg.expm(s * slope)[:, 2]
                return intensity * np.outer(column, column)

            A, Q, C = (
                scipy.linalg.expm(h * slope),
                scipy.integrate.quad_vec(noise_rate, 0.0, h)[0],
                np.array([1.0, 0.0, 0.0]),
            )
            P = np.eye(3)
            for _ in range(3000):
                L = P @ C / (C @ P @ C + parameters.position_noise**2)
                P = A @ (P - np.outer(L, C @ P)) @ A.T + Q
            self.models.append((A, L))
        self.x = np.array([[p, 0.0, 0.0] for p in start])

    def estimate(self, measured):
        for i, (_, L) in enumerate(self.models):
            self.x[i] = self.x[i] + L * (measured[i] - self.x[i, 0])
        return self.x[:, 2].copy()

    def predict(self, speed, distance):
        for i, (A, _) in enumerate(self.models):
            self.x[i] = A @ self.x[i] + [distance[i], speed[i], 0.0]


class DifferenceEstimator:
    """Filter of r, the measured minus the predicted velocity change over a tick, divided by the tick period.

    Args:
        filters: matrices (A, B, c) of each axis: x' = A x + B r, d = c x.
        h: tick period, s.
        rows: slice of the measurement that contains the velocity or rate to be differentiated.
    """

    def __init__(self, filters, h, rows):
        self.h, self.rows, self.v, self.expected = h, rows, np.zeros(3), np.zeros(3)
        self.filters = []
        for A, B, c in filters:
            n = len(A)
            flow = scipy.linalg.expm(h * np.block([[np.array(A), np.array(B)], [np.zeros((1, n + 1))]]))
            self.filters.append((flow, np.array(c)))
        self.x = [np.zeros(len(c)) for _, c in self.filters]

    @classmethod
    def adaptive(cls, parameters, h):
        """Return an L1 estimator, which filters r by exp(-adaptation h) ω / (s + ω); r as in `DifferenceEstimator`."""
        decay = math.exp(-parameters.adaptation * h)
        return cls([([[-w]], [[w]], [decay]) for w in parameters.bandwidth], h, slice(6, 9))

    @classmethod
    def incremental(cls, bandwidths, h, rows):
        """Return an INDI estimator, which filters r by ω² / (s² + √2 ω s + ω²); r as in `DifferenceEstimator`."""
        return cls(
            [([[0.0, 1.0], [-w * w, -math.sqrt(2.0) * w]], [[0.0], [w * w]], [1.0, 0.0]) for w in bandwidths], h, rows
        )

    def estimate(self, measured):
        r = (measured[self.rows] - self.v - self.expected) / self.h
        self.v = measured[self.rows]
        self.x = [(flow @ [*x, r_i])[:-1] for (flow, _), x, r_i in zip(self.filters, self.x, r, strict=True)]
        return np.array([c @ x for (_, c), x in zip(self.filters, self.x, strict=True)])

    def predict(self, speed, distance):
        self.expected = speed


class CommandEstimator:
    """Disturbance estimate from a nominal model of the response to commands."""

    def __init__(self, parameters, h, start):
        response, self.limit = parameters.response, parameters.disturbance_limit
        self.model = LaggedResponse(response.delay_ticks, [response.lag, response.feed_forward_lag or response.lag], h)
        self.law = law_of(parameters, h, start)

    def estimate(self, measured):
        return np.clip(self.law.estimate(measured), -self.limit, self.limit)

    def remember(self, command, correction, learned, feed_forward):
        self.law.predict(*self.model.follow(command + correction - feed_forward, feed_forward))


class TiltEstimator:
    """Disturbance estimate from the measured direction of the thrust. The acceleration is linear between ticks."""

    def __init__(self, parameters, h, start, gravity):
        self.h, self.limit, self.g = h, parameters.disturbance_limit, gravity
        self.line, self.lag = [gravity] * parameters.response.delay_ticks, parameters.response.lag
        self.thrust, self.last_acceleration, self.learned_disturbance = gravity, np.zeros(3), np.zeros(3)
        self.law = law_of(parameters, h, start)

    def estimate(self, measured):
        acceleration = self.thrust * rotation(*measured[3:6])[:, 2] - [0.0, 0.0, self.g]
        # Integrals of the acceleration, which changes linearly during the tick, and of the learned disturbance.
        slope = (acceleration - self.last_acceleration) / self.h
        speed = self.h * (self.last_acceleration + self.learned_disturbance) + self.h**2 / 2.0 * slope
        distance = self.h**2 / 2.0 * (self.last_acceleration + self.learned_disturbance) + self.h**3 / 6.0 * slope
        self.law.predict(speed, distance)
        self.last_acceleration = acceleration
        return np.clip(self.law.estimate(measured), -self.limit, self.limit)

    def remember(self, command, correction, learned, feed_forward):
        self.learned_disturbance = learned
        self.line.append(np.linalg.norm(np.add(command, [0.0, 0.0, self.g])))
        self.thrust += (1.0 - math.exp(-self.h / self.lag)) * (self.line.pop(0) - self.thrust)


def law_of(parameters, h, start):
    return {
        "disturbance_observer": lambda: KalmanFilter(parameters, h, start),
        "l1": lambda: DifferenceEstimator.adaptive(parameters, h),
        "indi": lambda: DifferenceEstimator.incremental(parameters.bandwidth, h, slice(6, 9)),
    }[parameters.kind]()


class IncrementalAttitude:
    """Incremental correction of the angular acceleration that an attitude controller commands."""

    def __init__(self, parameters, h):
        self.model, self.limit = (
            LaggedResponse(parameters.delay_ticks, [[parameters.lag] * 3], h),
            parameters.disturbance_limit,
        )
        self.law = DifferenceEstimator.incremental([parameters.bandwidth] * 3, h, slice(9, 12))

    def act(self, commanded, measured):
        corrected = commanded - np.clip(self.law.estimate(measured), -self.limit, self.limit)
        self.law.predict(*self.model.follow(corrected))
        return corrected


class Integral:
    """Integral i⁺ = i + h k_I e within a limit. The correction is -i, or -i⁺ with backward Euler."""

    def __init__(self, parameters, h):
        self.parameters, self.h, self.i = parameters, h, np.zeros(3)

    def output(self, inputs):
        return -self.i if self.parameters.integration == "forward_euler" else -self.updated(inputs)

    def signals(self):
        """Return the output signals by name."""
        return {}

    def updated(self, inputs):
        limit = self.parameters.integral_limit
        return np.clip(self.i + self.h * np.array(self.parameters.k_i) * inputs["error"], -limit, limit)

    def learn(self, tick, inputs):
        self.i = self.updated(inputs)


class Network:
    """Fuzzy network with adaptive consequents on some axes.

    Args:
        parameters: settings of the network, from the field `control.network` of the scenario.
        h: tick period, s.
        leg_times: times at which the legs of the route begin, s.
    """

    def __init__(self, parameters, h, leg_times):
        self.parameters, self.h = parameters, h
        learning = parameters.learning
        self.axes = ["xyz".index(axis) for axis in parameters.axes]
        self.R = math.prod(len(sets.centres) for _, sets in parameters.inputs if sets is not None)
        self.F = {axis: np.full(self.R, float(learning.initial_weight)) for axis in self.axes}
        self.memory = {axis: self._initial_memory() for axis in self.axes}
        self.resets = set()
        if getattr(learning, "reset", "never") == "at_segments":
            self.resets = {next(k for k in range(10**6) if k * h > time - 1e-9) for time in leg_times[1:]}

    def _initial_memory(self):
        """Return the initial covariance P₀ or the initial slope α₀."""
        learning = self.parameters.learning
        if learning.kind == "covariance":
            return learning.initial_covariance * np.eye(self.R)
        return learning.initial_slope if learning.kind == "sign" else None

    def firing(self, axis, inputs):
        """Return the normalised firing strengths W of all rules on an axis, eq (10) of the paper."""
        network = self.parameters
        used_inputs = [(name, sets) for name, sets in network.inputs if sets is not None]

        def strengths(exponent):
            w = np.ones(1)
            for name, sets in used_inputs:
                value = inputs[name][axis] if name.startswith("error") else inputs[name]
                w = np.outer(w, self.memberships(value, sets, exponent, circular=name == "phase")).ravel()
            return w / w.sum()

        if network.kind == "type_1":
            return strengths(1.0)
        return network.q * strengths(network.a2) + (1.0 - network.q) * strengths(network.a1)

    @staticmethod
    def memberships(value, sets, a, *, circular):
        """Return the memberships of an input in each set, eqs (11) and (12).

        The scaled input is limited to the universe of the sets, or wrapped on a circle.
        """
        if circular:
            gaps = [math.remainder(sets.scale * value - c, sets.scale) for c in sets.centres]
        else:
            gaps = np.clip(sets.scale * value, sets.centres[0], sets.centres[-1]) - np.array(sets.centres)
        u = [abs(gap / d) for gap, d in zip(gaps, sets.widths, strict=True)]
        return [(1.0 - distance**a) ** (1.0 / a) if distance < 1.0 else 0.0 for distance in u]

    def output(self, inputs):
        """Return the network's output Fᵀ W on each axis; zero on axes without a network."""
        tau = np.zeros(3)
        for axis in self.axes:
            tau[axis] = self.F[axis] @ self.firing(axis, inputs)
        return tau

    def signals(self):
        """Return the output signals by name."""
        weights = {"weights": np.concatenate([self.F[axis] for axis in self.axes])}
        if self.parameters.learning.kind != "covariance":
            return weights
        return weights | {"covariance_trace": np.array([np.trace(self.memory[axis]) for axis in self.axes])}

    def learn(self, tick, inputs):
        learning, h = self.parameters.learning, self.h
        limit = math.inf if learning.weight_limit is None else learning.weight_limit
        for axis in self.axes:
            if tick in self.resets:
                self.memory[axis] = self._initial_memory()
            W = self.firing(axis, inputs)
            if learning.kind == "sign" or learning.signal == "feedback":
                signal = inputs["pd"][axis] - inputs["disturbance"][axis]
            else:  # eq (15)
                signal = inputs["error_rate"][axis] + learning.slope * inputs["error"][axis]
            if abs(signal) < learning.deadzone:
                signal = 0.0
            F = self.F[axis] * math.exp(-learning.leakage * h)
            if learning.kind == "covariance":
                F = F + self._covariance_change(axis, W, signal)
            elif learning.kind == "gradient":
                F = F - h * learning.rate * signal * W
            else:
                F = F - h * self.memory[axis] * np.sign(signal) * W / (W @ W)
                self.memory[axis] += 2.0 * h * learning.rate * abs(signal)
            self.F[axis] = np.clip(F, -limit, limit)

    def _covariance_change(self, axis, W, signal):
        """Update the covariance, and return the change of the weights.

        The update is the exact solution of eqs (16) and (17) for constant inputs over a tick, followed by bounded-gain
        forgetting.
        """
        learning, h, P = self.parameters.learning, self.h, self.memory[axis]
        g = P @ W
        c = W @ g
        change = -learning.gain * signal * g * math.log1p(h * c) / c
        P = P - h * np.outer(g, g) / (1.0 + h * c)
        max_trace = self.R * learning.initial_covariance
        mu = 1.0 - (1.0 - learning.forgetting) * max(0.0, 1.0 - np.trace(P) / max_trace)
        self.memory[axis] = P / mu
        return change


class Controller:
    """Cascade of the controllers of a scenario. All controllers use the nominal parameters of the vehicle.

    Args:
        scenario: scenario without distributions.
        leg_times: times at which the legs of the route begin, s.
        duration: time at which the route ends, s.
        start: initial position of the vehicle, m.
    """

    def __init__(self, scenario, leg_times, duration, start):
        self.parameters, self.nominal = scenario.control, scenario.nominal
        position, h = scenario.control.position, scenario.laboratory.command_link.period
        self.law = self.estimator = self.incremental_attitude = None
        self.duration, self.h = duration, h
        if position.kind == "pid":
            self.law = Integral(position, h)
        elif scenario.control.network is not None:
            self.law = Network(scenario.control.network, h, leg_times)
        if position.kind in ("disturbance_observer", "l1", "indi"):
            if position.response.kind == "tilt":
                self.estimator = TiltEstimator(position, h, start, scenario.nominal.gravity)
            else:
                self.estimator = CommandEstimator(position, h, start)
        if self.parameters.attitude is not None and self.parameters.attitude.kind == "indi":
            self.incremental_attitude = IncrementalAttitude(self.parameters.attitude, h)
        self.attitude_integral = np.zeros(3)  # rad/s², integral term as an angular acceleration

    def phase(self, time):
        """Return the completed fraction of the route at a time."""
        return min(time / self.duration, 1.0)

    def act(self, tick, measured, reference):
        """Return the signals of a tick by name, and update the learned parameters."""
        position = self.parameters.position
        error = reference["position"] - measured[0:3]
        on_error = position.derivative == "tracking_error"
        rate = on_error * reference["velocity"] - measured[6:9]
        pd = np.array(position.k_p) * error + np.array(position.k_d) * rate  # eq (8)
        correction, learned, signals, disturbance = np.zeros(3), np.zeros(3), {}, np.zeros(3)
        if self.estimator is not None:
            disturbance = self.estimator.estimate(measured)
        if self.law is not None:
            lead = 0.0 if self.parameters.network is None else self.parameters.network.lead
            current_inputs, future_inputs = (
                {
                    "error": error,
                    "error_rate": rate,
                    "pd": pd,
                    "disturbance": disturbance,
                    **dict(zip(("x", "y", "z"), measured[0:3] + advance * measured[6:9], strict=True)),
                    **dict(zip(("v_x", "v_y", "v_z"), measured[6:9], strict=True)),
                    "phase": self.phase(tick * self.h + advance),
                }
                for advance in (0.0, lead)
            )
            correction, learned, signals = (
                self.law.output(future_inputs),
                self.law.output(current_inputs),
                self.law.signals(),
            )
            self.law.learn(tick, current_inputs)
        u = pd - correction  # eq (14)
        fed_forward = (position.feed_forward != "none") * reference["acceleration"]
        u = u + fed_forward
        if self.estimator is not None:
            signals["disturbance"] = disturbance
            u = u - disturbance
            self.estimator.remember(u, correction, learned, fed_forward)
        thrust, attitude, rates, accelerations = self.thrust_vectoring(u, measured, reference)
        if self.parameters.attitude is None:
            command = {"attitude_target": np.array([thrust, *attitude, *rates])}
        else:
            command = {"wrench": np.array([thrust, *self.torque(measured, attitude, rates, accelerations)])}
        return {
            "error": error,
            "error_rate": rate,
            "pd": pd,
            "correction": correction,
            "acceleration_command": u,
            "attitude_command": attitude,
            **command,
            **signals,
        }

    def thrust_vectoring(self, u, measured, reference):
        """Return thrust, attitude, body rates and angular accelerations by eq (7), for any yaw and within limits."""
        mass, gravity, limits = self.nominal.mass, self.nominal.gravity, self.parameters.thrust_vectoring
        geometric = self.parameters.attitude is not None and self.parameters.attitude.kind == "geometric"
        yaw = reference["yaw"] if geometric else measured[5]
        is_zxy = geometric and self.parameters.attitude.euler_sequence == "zxy"
        heading = rotation(0.0, 0.0, yaw)
        forward, left, up = heading.T @ u + [0.0, 0.0, gravity]
        # The vertical component is limited first, and then the horizontal components.
        up = min(max(up, limits.min_thrust * gravity), limits.max_thrust * gravity)
        max_horizontal = min(up * math.tan(limits.max_tilt), math.sqrt((limits.max_thrust * gravity) ** 2 - up**2))
        horizontal = math.hypot(forward, left)
        if horizontal > max_horizontal:
            forward, left = forward * max_horizontal / horizontal, left * max_horizontal / horizontal
        thrust = math.sqrt(forward**2 + left**2 + up**2)
        pitch, roll = math.atan(forward / up), math.asin(-left / thrust)
        jerk, snap = reference["jerk"], reference["snap"]
        psi_dot, psi_ddot = reference["yaw_rate"], reference["yaw_acceleration"]
        order = ("none", "acceleration", "jerk", "snap").index(self.parameters.position.feed_forward)
        jerk, snap = (jerk if order >= 2 else np.zeros(3)), (snap if order >= 3 else np.zeros(3))
        attitude = np.array([roll, pitch, reference["yaw"]])
        rates, accelerations = flatness(roll, pitch, yaw, thrust, jerk, snap, psi_dot, psi_ddot)
        if is_zxy:
            axes = zxy_axes(heading @ [forward, left, up], yaw)
            attitude = angles_near(axes, yaw)
            rates, accelerations = zxy_flatness(axes, yaw, thrust, jerk, snap, psi_dot, psi_ddot)
        if order < 3:
            accelerations = np.zeros(3)
        if geometric:
            force = heading @ [forward, left, up]
            thrust = max(force @ rotation(*measured[3:6])[:, 2], limits.min_thrust * gravity)
        return mass * thrust, attitude, rates, accelerations

    def torque(self, measured, attitude, rates, accelerations):
        """Return the torque of the attitude PD, τ = I (k_P e + k_D ė + ω̇) + ω x I ω, or of a variant of it."""
        inertia, gains = np.diag(self.nominal.inertia), self.parameters.attitude
        k_p, k_d = np.array(gains.k_p), np.array(gains.k_d)
        if gains.kind == "geometric":
            torque = geometric_torque(measured, attitude, rates, accelerations, k_p, k_d, inertia)
            if not gains.transport_term:
                carried = rotation(*measured[3:6]).T @ rotation(*attitude) @ rates
                torque = torque + inertia @ cross(measured[9:12], carried)
            if gains.k_i is None:
                return torque
            integral_before = self.attitude_integral
            step = self.h * np.array(gains.k_i) * rotation_error(measured, attitude)
            self.attitude_integral = np.clip(self.attitude_integral + step, -gains.integral_limit, gains.integral_limit)
            return torque - inertia @ (
                integral_before if gains.integration == "forward_euler" else self.attitude_integral
            )
        error = attitude - measured[3:6]
        error[2] = math.remainder(error[2], math.tau)
        angular_acceleration = k_p * error + k_d * (rates - measured[9:12]) + accelerations
        if self.incremental_attitude is not None:
            angular_acceleration = self.incremental_attitude.act(angular_acceleration, measured)
        return inertia @ angular_acceleration + cross(rates, inertia @ rates)


def rotation_error(measured, attitude):
    """Return the rotation error e_R of Lee, Leok and McClamroch (2010), eq (10)."""
    R, R_d = rotation(*measured[3:6]), rotation(*attitude)
    skew = 0.5 * (R_d.T @ R - R.T @ R_d)
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def geometric_torque(measured, attitude, rates, accelerations, k_p, k_d, J):
    """Return the torque of Lee, Leok and McClamroch (2010), eqs (10), (11) and (16), with gains times the inertia."""
    R, R_d, Omega = rotation(*measured[3:6]), rotation(*attitude), measured[9:12]
    e_R, e_Omega = rotation_error(measured, attitude), Omega - R.T @ R_d @ rates
    follow = cross(Omega, R.T @ R_d @ rates) - R.T @ R_d @ accelerations
    return -J @ (k_p * e_R) - J @ (k_d * e_Omega) + cross(Omega, J @ Omega) - J @ follow


def flatness(roll, pitch, yaw, thrust, jerk, snap, psi_dot, psi_ddot):
    """Return body rates and angular accelerations, given jerk and snap of F z_B and the yaw rate.

    p and q follow from ż_B = q x_B - p y_B, and their derivatives from the derivative of this equation. r and its
    derivative follow from the yaw rate by eq (2) and its derivative.
    """
    x_B, y_B, z_B = rotation(roll, pitch, yaw).T
    F_dot = z_B @ jerk
    p, q = -y_B @ jerk / thrust, x_B @ jerk / thrust
    E = euler_to_body(roll, pitch)
    # The first two rows of eq (2) give the rates of roll and pitch, and the third row gives r.
    angle_rates = np.array([*np.linalg.solve(E[:2, :2], np.array([p, q]) - E[:2, 2] * psi_dot), psi_dot])
    r = E[2] @ angle_rates
    p_dot = q * r - (y_B @ snap + 2.0 * F_dot * p) / thrust
    q_dot = (x_B @ snap - 2.0 * F_dot * q) / thrust - p * r
    # Time derivative of E, the matrix of eq (2).
    s, c, s_pitch, c_pitch = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    phi_dot, theta_dot, _ = angle_rates
    E_dot = np.array(
        [
            [0.0, 0.0, -c_pitch * theta_dot],
            [0.0, -s * phi_dot, c * c_pitch * phi_dot - s * s_pitch * theta_dot],
            [0.0, -c * phi_dot, -s * c_pitch * phi_dot - c * s_pitch * theta_dot],
        ]
    )
    from_E_dot = E_dot @ angle_rates
    right = np.array([p_dot, q_dot]) - from_E_dot[:2] - E[:2, 2] * psi_ddot
    angle_accelerations = np.array([*np.linalg.solve(E[:2, :2], right), psi_ddot])
    return np.array([p, q, r]), np.array([p_dot, q_dot, from_E_dot[2] + E[2] @ angle_accelerations])


def zxy_axes(force, yaw):
    """Return the body axes as columns, with z_B along a force and y_B normal to the heading (Euler sequence zxy)."""
    z_B = force / np.linalg.norm(force)
    y_B = cross(z_B, [math.cos(yaw), math.sin(yaw), 0.0])
    y_B = y_B / np.linalg.norm(y_B)
    return np.column_stack([cross(y_B, z_B), y_B, z_B])


def angles_near(axes, yaw):
    """Return roll, pitch and yaw of eq (1), with the yaw within half a turn of a given yaw."""
    axes_yaw, pitch, roll = scipy.spatial.transform.Rotation.from_matrix(axes).as_euler("ZYX")
    return np.array([roll, pitch, yaw + math.remainder(axes_yaw - yaw, math.tau)])


def zxy_flatness(axes, yaw, thrust, jerk, snap, psi_dot, psi_ddot):
    """Return body rates and angular accelerations like `flat`, for the Euler sequence zxy: y_B is normal to x_C.

    r and its derivative follow from y_B·x_C = 0, differentiated once and twice.
    """
    x_B, y_B, z_B = axes.T
    x_C = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    y_C = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    F_dot = z_B @ jerk
    p, q = -y_B @ jerk / thrust, x_B @ jerk / thrust
    r = (p * (z_B @ x_C) + psi_dot * (y_B @ y_C)) / (x_B @ x_C)
    p_dot = q * r - (y_B @ snap + 2.0 * F_dot * p) / thrust
    q_dot = (x_B @ snap - 2.0 * F_dot * q) / thrust - p * r
    x_dot, y_dot, z_dot = (cross(axes @ [p, q, r], axis) for axis in (x_B, y_B, z_B))
    right = p_dot * (z_B @ x_C) + p * (z_dot @ x_C + psi_dot * (z_B @ y_C))
    right += psi_ddot * (y_B @ y_C) + psi_dot * (y_dot @ y_C - psi_dot * (y_B @ x_C))
    left = r * (x_dot @ x_C + psi_dot * (x_B @ y_C))
    return np.array([p, q, r]), np.array([p_dot, q_dot, (right - left) / (x_B @ x_C)])
