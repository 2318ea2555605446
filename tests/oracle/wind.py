"""Wind, which is constant over a step of the vehicle: steady wind, gusts, Dryden turbulence, and jets of fans."""

import math

import numpy as np
import scipy

from oracle.randomness import WIND, Stream

FOOT = 0.3048  # m
KNOT = 1852.0 / 3600.0  # m/s


def velocity_of(source):
    """Return the velocity of a steady wind, a gust or a sine."""
    if source.velocity is not None:
        return np.array(source.velocity)
    return source.speed * np.array([math.cos(source.heading), math.sin(source.heading), 0.0])


class Gust:
    """Gust with a 1-cosine shape, sampled in the middle of each step."""

    def __init__(self, source, h):
        self.source, self.h, self.velocity = source, h, velocity_of(source)

    def sample(self, k, position):
        time, rise = (k + 0.5) * self.h - self.source.start, self.source.rise_time
        hold = math.inf if self.source.hold_time is None else self.source.hold_time
        if time <= 0.0 or time >= 2.0 * rise + hold:
            fraction = 0.0
        elif time < rise:
            fraction = 0.5 * (1.0 - math.cos(math.pi * time / rise))
        elif time <= rise + hold:
            fraction = 1.0
        else:
            fraction = 0.5 * (1.0 + math.cos(math.pi * (time - rise - hold) / rise))
        return fraction * self.velocity


class Sine:
    """Sinusoidal wind, sampled in the middle of each step."""

    def __init__(self, source, h):
        self.source, self.h, self.velocity = source, h, velocity_of(source)

    def sample(self, k, position):
        return math.sin(self.source.frequency * (k + 0.5) * self.h + self.source.phase) * self.velocity


class Dryden:
    """Dryden turbulence of MIL-F-8785C: filtered white noise, whose impulse responses are integrated over a step.

    f = √(2 / T) ∫ exp(-t / T) dw has unit variance, and g is f after another filter 1 / (1 + T s).
    """

    def __init__(self, source, steady, h, stream):
        self.stream = stream
        height = max(source.height / FOOT, 10.0)
        wind_at_20_feet = {"light": 15.0, "moderate": 30.0, "severe": 45.0}[source.level] * KNOT * source.intensity
        shear = 0.177 + 0.000823 * height
        sigma_w = 0.1 * wind_at_20_feet
        self.sigma = np.array([sigma_w / shear**0.4, sigma_w / shear**0.4, sigma_w])
        lengths = np.array([height / shear**1.2, height / shear**1.2, height]) * FOOT
        airspeed = max(math.hypot(*steady) if source.airspeed is None else source.airspeed, 1.0)
        heading = math.atan2(steady[1], steady[0]) if source.heading is None else source.heading
        c, s = math.cos(heading), math.sin(heading)
        self.R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self.transitions, self.noises = zip(*(self._sampled(length / airspeed, h) for length in lengths), strict=True)
        self.state = None

    @staticmethod
    def _sampled(T, h):
        """Return the transition matrix of the filter states f and g, and the Cholesky factor of the noise per step."""

        def response(t):
            return math.sqrt(2.0 / T) * math.exp(-t / T) * np.array([1.0, t / T])

        p = math.exp(-h / T)
        transition = np.array([[p, 0.0], [h / T * p, p]])
        covariance = [
            [
                scipy.integrate.quad(lambda t, i=i, j=j: response(t)[i] * response(t)[j], 0.0, h, epsabs=0.0)[0]
                for j in range(2)
            ]
            for i in range(2)
        ]
        return transition, np.linalg.cholesky(covariance)

    def sample(self, k, position):
        n = self.stream.normal(k)
        noise = np.array([[n[0], 0.0], [n[1], n[3]], [n[2], n[4]]])  # columns: f and g; rows: u, v and w
        if k == 0:
            stationary = np.linalg.cholesky([[1.0, 0.5], [0.5, 0.5]])
            self.state = [stationary @ part for part in noise]
        else:
            self.state = [
                A @ x + L @ part for A, L, x, part in zip(self.transitions, self.noises, self.state, noise, strict=True)
            ]
        along = self.state[0][0]
        across = [(math.sqrt(3.0) * f + (1.0 - math.sqrt(3.0)) * g) / math.sqrt(2.0) for f, g in self.state[1:]]
        return self.R @ (self.sigma * [along, *across])


class Fans:
    """Round free jets of fans with turbulence, a Gauss-Markov process on each axis."""

    def __init__(self, sources, h, stream):
        self.sources, self.h, self.stream, self.eddies = sources, h, stream, None

    @staticmethod
    def jet(source, position):
        """Return the velocity of a jet at a position, and its half-width there."""
        direction = np.array(source.direction) / np.linalg.norm(source.direction)
        D, exit_speed = source.diameter, 4.0 * source.flow / (math.pi * source.diameter**2)
        offset = position - np.array(source.position)
        x = offset @ direction
        if x <= 0.0:
            return np.zeros(3), 1.0  # behind the outlet
        r, half = np.linalg.norm(offset - x * direction), 0.094 * x
        centreline = exit_speed if x < 5.9 * D else 5.9 * exit_speed * D / x
        core = max(0.5 * D * (1.0 - x / (5.9 * D)), 0.0)  # radius of the potential core, a cone on the outlet
        flank = 0.5 ** ((max(r - core, 0.0) / half) ** 2)
        return centreline * flank * direction, half

    def sample(self, k, position):
        mean, variance, rate = np.zeros(3), 0.0, 0.0
        for source in self.sources:
            velocity, half = self.jet(source, position)
            speed = np.linalg.norm(velocity)
            mean, variance = mean + velocity, variance + (source.turbulence * speed) ** 2
            rate += speed / half
        n = self.stream.normal(k)
        decay = math.exp(-rate * self.h)
        self.eddies = n if k == 0 else decay * self.eddies + math.sqrt(1.0 - decay**2) * n
        return mean + math.sqrt(variance) * self.eddies


class Wind:
    """Total wind of all wind sources of a scenario."""

    def __init__(self, sources, h, seed, sample):
        self.steady = sum((velocity_of(source) for source in sources if source.kind == "steady"), start=np.zeros(3))
        self.parts = [Gust(source, h) for source in sources if source.kind == "gust"]
        self.parts += [Sine(source, h) for source in sources if source.kind == "sine"]
        for i, source in enumerate(source for source in sources if source.kind == "dryden"):
            stream = Stream(seed, sample, WIND, f"dryden_{i}.turbulence_noise", 5)
            self.parts.append(Dryden(source, self.steady, h, stream))
        fans = [source for source in sources if source.kind == "fan"]
        if fans:
            self.parts.append(Fans(fans, h, Stream(seed, sample, WIND, "fans.jet_noise", 3)))

    def sample(self, k, position):
        """Return the wind over step k, given the position of the vehicle at the beginning of the step."""
        return sum((part.sample(k, position) for part in self.parts), start=self.steady)
