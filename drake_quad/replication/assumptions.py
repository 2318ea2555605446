"""What the paper does not say, and what is assumed in its place."""

from typing import NamedTuple

from drake_quad.flight.mission import plan_route
from drake_quad.reference.polynomial_path import peak_norm
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.networks.learning import CovarianceLearning
from drake_quad.scenario.networks.network import Type2Network
from drake_quad.scenario.routes.figure_eight import FigureEightRoute
from drake_quad.scenario.winds.source import jets


class Assumption(NamedTuple):
    """Something that had to be assumed.

    Attributes:
        what: that the paper does not say.
        value: that is taken in its place.
        reason: why this value.
    """

    what: str
    value: str
    reason: str


def assumptions(low_wind: Scenario) -> list[Assumption]:
    """Every assumption, in the order of the report.

    Args:
        low_wind: the scenario of PD+T2FNN in low wind, from which the values are read.
    """
    return [*_of_route(low_wind), *_of_vehicle(low_wind), *_of_laboratory(low_wind), *_of_control(low_wind)]


def _of_route(scenario: Scenario) -> list[Assumption]:
    route, plan = scenario.route, plan_route(scenario)
    assert isinstance(route, FigureEightRoute)
    return [
        Assumption(
            "waypoints",
            f"two circles of {route.radius:g} m at {route.lower_height:g} and {route.upper_height:g} m, centres"
            f" {route.offset:g} m from the start",
            "the extent of the paper's figures",
        ),
        Assumption(
            "segment times",
            f"{plan.duration:.2f} s in all; speed up to {peak_norm(plan.path, 1):.2f} m/s, acceleration up to"
            f" {peak_norm(plan.path, 2):.2f} m/s²",
            "as fast as the paper's limits on both allow; the time axes of its figures cannot be seconds",
        ),
        Assumption(
            "Table II's runs", "the first three samples of each cell", "the paper repeats each case three times"
        ),
    ]


def _of_vehicle(scenario: Scenario) -> list[Assumption]:
    vehicle = scenario.vehicle
    return [
        Assumption(
            "limits of the rotors",
            f"{vehicle.min_rotor_speed:g} to {vehicle.max_rotor_speed:g} rad/s",
            "hover takes 201 rad/s; the top gives 2.2 times the thrust of hover, a usual ratio",
        ),
        Assumption("lag of the rotors", f"{vehicle.rotor_time_constant:g} s", "usual for propellers of 8 inches"),
        Assumption(
            "drag",
            f"{vehicle.linear_drag:g} N s/m and {vehicle.quadratic_drag:g} N s²/m²",
            "the least that small quadrotors show; the fans then push by what the errors in wind allow for",
        ),
        Assumption("rigid body", "exact", "eq (3) has accelerations of Euler angles where those of body rates belong"),
    ]


def _of_laboratory(scenario: Scenario) -> list[Assumption]:
    cameras, link = scenario.laboratory.motion_capture, scenario.laboratory.command_link
    first, second = jets(scenario.laboratory.wind)
    places = " and ".join(f"({', '.join(f'{each:g}' for each in jet.outlet)}) m" for jet in (first, second))
    bandwidth = cameras.derivative_bandwidth
    assert bandwidth is not None
    return [
        Assumption(
            "noise of the positions",
            f"{1e3 * cameras.position_noise:g} mm",
            "the paper's 1 mm, taken for a standard deviation",
        ),
        Assumption(
            "noise of the angles",
            f"{1e3 * cameras.attitude_noise:g} mrad",
            "of two markers 1 mm off, each at one end of an arm pair",
        ),
        Assumption(
            "how velocities are made",
            f"filtered differences, {bandwidth:g} rad/s",
            "12.5 ms of lag; less would hand on more noise, more would unsettle the attitude",
        ),
        Assumption(
            "delay of the link",
            f"{1e3 * link.period * link.delay_ticks:g} ms",
            "what is sent at a tick acts at the next",
        ),
        Assumption(
            "loss of the link",
            f"{100.0 * link.loss_rate:g} % of the packets",
            "the rate at which radio links of this kind state their sensitivity",
        ),
        Assumption(
            "the two fans",
            f"{first.diameter:g} m wide, at {places}, blowing along Y",
            "so that they blow along the route, of which by the paper a large portion is covered; jets spread and slow"
            " down as free ones do",
        ),
        Assumption("turbulence of the fans", f"{100.0 * first.turbulence:g} %", "20 to 25 % on the axis of a free jet"),
    ]


def _of_control(scenario: Scenario) -> list[Assumption]:
    cascade = scenario.cascade
    position, network, attitude = cascade.position.plain(), cascade.network, cascade.attitude
    assert isinstance(network, Type2Network)
    sets, rate_sets, learning = network.inputs.error, network.inputs.error_rate, network.learning
    assert sets is not None
    assert rate_sets is not None
    assert isinstance(learning, CovarianceLearning)
    assert attitude is not None
    count = len(sets.centres)
    return [
        Assumption(
            "k_P, k_D on X and Y",
            f"{position.k_p[0]:g} 1/s², {position.k_d[0]:g} 1/s",
            "calibrated, with a damping ratio of 0.7",
        ),
        Assumption("ė of the PD", "minus the velocity", "calibrated: the hypothesis whose predictions are best"),
        Assumption(
            "k_P, k_D on Z",
            f"{position.k_p[2]:g} 1/s², {position.k_d[2]:g} 1/s",
            "designed by `drake-quad design`; nothing is asked of them here",
        ),
        Assumption(
            "gains of roll and pitch",
            f"{attitude.k_p[0]:g} 1/s², {attitude.k_d[0]:g} 1/s",
            "as stiff as it must be with a network around it; with what is designed for the PD alone it oscillates",
        ),
        Assumption("λ", f"{learning.slope:g} 1/s", "calibrated"),
        Assumption(
            "K_D, P₀",
            f"{learning.gain:g} 1/s, {learning.initial_covariance:g} I 1/s",
            "a network that learns within a second or two; ten times P₀ makes it oscillate",
        ),
        Assumption("F₀", f"{learning.initial_weight:g} m/s²", "the network begins without knowing anything"),
        Assumption("q", f"{network.q:g}", "the middle; the report varies it"),
        Assumption(
            "fuzzy sets",
            f"{count} × {count}, centres {', '.join(f'{c:g}' for c in sets.centres)}, widths {sets.widths[0]:g}",
            "what other work of the authors' group uses",
        ),
        Assumption(
            "scales of the inputs",
            f"{sets.scale:g} 1/m, {rate_sets.scale:g} s/m",
            "the sets span the paper's largest error, 1.3 m, and its top speed, 2 m/s",
        ),
        Assumption(
            "exponents of PD+T2FNN without wind",
            f"a₁ = {network.a1:g}, a₂ = {network.a2:g}",
            "not printed; taken for the narrower of the two pairs in wind",
        ),
        Assumption(
            "control effort",
            "mean of the squared command on an axis, m²/s⁴",
            "not defined; other definitions are compared below",
        ),
        Assumption("(17) at 50 Hz", "exact step of the sampled law", "an explicit Euler step of it is unstable"),
    ]
