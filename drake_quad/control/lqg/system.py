"""Linear-quadratic-Gaussian control as a Drake system."""

from typing import Any, Literal

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.cascade import add_network
from drake_quad.control.lqg import laws
from drake_quad.control.lqg.laws import (
    ChainCommands,
    Deviations,
    Estimate,
    KalmanState,
    LqgParameters,
    RegulatorOutput,
    SentCommands,
)
from drake_quad.framework.elementary import identity, where
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import Layout, layout_of
from drake_quad.framework.wiring import append, build
from drake_quad.signals import (
    Acceleration,
    AttitudeTarget,
    Jerk,
    PositionError,
    PositionErrorRate,
    Reference,
    Snap,
    Wrench,
)

LinkSignal = Literal["wrench", "attitude_target"]


def _regulate(
    reference: Reference,
    jerk: Jerk,
    snap: Snap,
    correction: Acceleration | None,
    perturbation: ChainCommands | None,
    tick: float,
    *filter_inputs: Any,
) -> tuple[Estimate, RegulatorOutput]:
    """Return the current estimate and the output of the regulator.

    Before the first frame, the current snap is also used as the previous snap.
    """
    _, before, sent, _, parameters, *_ = filter_inputs
    estimate = laws.estimator_step(*filter_inputs)
    if sent.snap is not None:
        sent = sent._replace(snap=where(before.has_started != 0.0, sent.snap, snap))
    return estimate, laws.regulator_output(
        estimate, reference, jerk, snap, sent, correction, perturbation, parameters, tick
    )


def _wrench(reference: Reference, jerk: Jerk, snap: Snap, *reads: Any) -> Wrench:
    estimate, regulated = _regulate(reference, jerk, snap, *reads)
    _, _, _, measurement, _, _, _, parameters, *_ = reads
    return laws.wrench_from_snap(regulated, estimate, measurement, reference, jerk, snap, parameters)


def _target(reference: Reference, jerk: Jerk, snap: Snap, *reads: Any) -> AttitudeTarget:
    estimate, regulated = _regulate(reference, jerk, snap, *reads)
    _, _, _, measurement, _, _, _, parameters, *_ = reads
    return laws.target_from_acceleration(regulated, estimate, measurement, reference, parameters)


def _acceleration(*reads: Any) -> Acceleration:
    _, regulated = _regulate(*reads)
    return regulated.acceleration


def _next_sent(reference: Reference, jerk: Jerk, snap: Snap, *reads: Any) -> SentCommands:
    _, regulated = _regulate(reference, jerk, snap, *reads)
    _, _, _, _, _, sent, *_ = reads
    return laws.next_sent(regulated, snap, sent)


def _deviation(
    reference: Reference, jerk: Jerk, snap: Snap, correction: Acceleration | None, *filter_inputs: Any
) -> Deviations:
    _, _, sent, *_ = filter_inputs
    return laws.feedback_deviations(laws.estimator_step(*filter_inputs), reference, jerk, snap, sent, correction)


def _error(reference: Reference, *filter_inputs: Any) -> PositionError:
    return laws.position_error(laws.estimator_step(*filter_inputs), reference)


def _error_rate(reference: Reference, *filter_inputs: Any) -> PositionErrorRate:
    return laws.position_error_rate(laws.estimator_step(*filter_inputs), reference)


def _pd(reference: Reference, *filter_inputs: Any) -> Acceleration:
    _, _, _, _, parameters, *_ = filter_inputs
    estimate = laws.estimator_step(*filter_inputs)
    error, rate = laws.position_error(estimate, reference), laws.position_error_rate(estimate, reference)
    return laws.outer_feedback(error, rate, parameters)


def _disturbance(*filter_inputs: Any) -> Acceleration:
    return laws.total_disturbance(laws.estimator_step(*filter_inputs))


def _no_acceleration(parameters: LqgParameters) -> Acceleration:
    return Acceleration(0.0, 0.0, 0.0)


def deviation_layout(parameters: LqgParameters) -> Layout:
    """Return the layout of the port `deviation`."""
    lateral, vertical = ((*loop.K, *loop.K_pending) for loop in (parameters.lateral, parameters.vertical))
    return layout_of(Deviations, Deviations(lateral, lateral, vertical, _no_acceleration(parameters)))


def _initial_filter(parameters: LqgParameters) -> KalmanState:
    lateral, vertical = ([type(loop.K)(*[0.0] * len(loop.K))] for loop in (parameters.lateral, parameters.vertical))
    return KalmanState(Estimate(*lateral, *lateral, *vertical), 0.0, 0.0)


@fleet_system(float, AutoDiffXd)
class LinearQuadraticGaussian(FleetSystem):
    """Kalman filter and linear-quadratic regulator, which replace the whole cascade.

    .. pydrake_system::

        name: LinearQuadraticGaussian
        input_ports:
        - measurement
        - reference
        - reference_jerk
        - reference_snap
        - correction
        - learned_disturbance
        - perturbation
        output_ports:
        - wrench
        - acceleration_command
        - error
        - error_rate
        - pd
        - disturbance
        - deviation

    The filter is updated at every frame. At every tick, the commands are computed from its estimate. The equations are
    in `drake_quad.control.lqg.laws`, the models in `drake_quad.control.lqg.chains`. With an autopilot the output
    `attitude_target` replaces `wrench`. `error` and `error_rate` are computed from the estimate. `pd` is the
    acceleration that the regulator commands for these errors. `acceleration_command` is a_r + `pd` minus the
    compensation of disturbances, within limits. `disturbance` is the estimate of the disturbing acceleration.

    The ports `correction` and `learned_disturbance` exist if there is a network. `correction` is an acceleration that
    is subtracted from the command. The filter treats `learned_disturbance` as a known disturbance from the next frame
    on, so that `disturbance` contains only the remaining disturbance, and the network does not close an algebraic loop.
    The two inputs differ by the lead time of the network.

    The ports `perturbation` and `deviation` exist if another system instead of the regulator keeps the tilt within its
    limits (`drake_quad.control.mpc.system`). From `deviation`, the state that the regulator feeds back, this system
    computes `perturbation`, which is added to the commands.

    The states are `filter`, `sent` and, with the port `learned_disturbance`, `known_disturbance`. The only parameter of
    the context is `parameters`.

    Args:
        num_vehicles: number of vehicles N.
        signal: signal that is sent over the link, "wrench" or "attitude_target".
        period: frame period h, s.
        tick: control period, s; a whole number of frames.
        loses_frames: True if a frame counts as lost when its x exactly equals the x of the previous frame.
        takes_correction: True if the ports `correction` and `learned_disturbance` exist.
        takes_perturbation: True if the ports `perturbation` and `deviation` exist.
        parameters: parameters of the controller.
    """

    def declare(
        self,
        *,
        signal: LinkSignal = "wrench",
        period: float = 0.01,
        tick: float = 0.02,
        loses_frames: bool = False,
        takes_correction: bool = False,
        takes_perturbation: bool = False,
        parameters: LqgParameters,
    ) -> None:
        """Declare the ports, states and parameters of this system."""
        measurement, reference = self.input("measurement"), self.input("reference")
        jerk = self.input("reference_jerk", absent=Jerk(0.0, 0.0, 0.0))
        snap = self.input("reference_snap", absent=Snap(0.0, 0.0, 0.0, 0.0))
        parameter = self.parameter("parameters", lambda parameters: parameters)
        before, sent = self.state("filter", _initial_filter), self.state("sent", SentCommands.hovering)
        correction = known_disturbance = perturbation = None
        if takes_correction:
            correction = self.input("correction", absent=Acceleration(0.0, 0.0, 0.0))
            known_disturbance = self.state("known_disturbance", _no_acceleration)
            learned = self.input("learned_disturbance", absent=Acceleration(0.0, 0.0, 0.0))
            self.update(period, identity, learned, writes=[known_disturbance])
        if takes_perturbation:
            perturbation = self.input("perturbation", layout=layout_of(ChainCommands))
        filter_inputs = measurement, before, sent, known_disturbance, parameter, period, loses_frames
        regulator_inputs = reference, jerk, snap, correction, perturbation, tick, *filter_inputs
        self.update(period, laws.filter_step, *filter_inputs, writes=[before])
        self.update(tick, _next_sent, *regulator_inputs, writes=[sent])
        if signal == "wrench":
            self.output("wrench", _wrench, *regulator_inputs)
        else:
            self.output("attitude_target", _target, *regulator_inputs)
        self.output("acceleration_command", _acceleration, *regulator_inputs)
        self.output("error", _error, reference, *filter_inputs)
        self.output("error_rate", _error_rate, reference, *filter_inputs)
        self.output("pd", _pd, reference, *filter_inputs)
        self.output("disturbance", _disturbance, *filter_inputs)
        if takes_perturbation:
            deviation_inputs = reference, jerk, snap, correction, *filter_inputs
            self.output("deviation", _deviation, *deviation_inputs, layout=deviation_layout(parameters))


def build_lqg_control(regulator: Any, network: Any = None, programme: Any = None) -> Diagram:
    """Build the diagram `control` of the controller, with an optional network and an optional predictive programme.

    Args:
        regulator: a `LinearQuadraticGaussian`, with the port `correction` if there is a network, and with the port
            `perturbation` if there is a programme.
        network: network whose correction the controller subtracts; None without a network.
        programme: `PredictiveProgramme` that keeps the controller within its limits; None without a programme.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("regulator", regulator)
    for port in map(regulator.get_input_port, range(regulator.num_input_ports())):
        if port.get_name() not in ("correction", "learned_disturbance", "perturbation"):
            builder.ExportInput(port, port.get_name())
    if programme is not None:
        perturbation = append(builder, "programme", programme, regulator.GetOutputPort("deviation"))
        builder.Connect(perturbation, regulator.GetInputPort("perturbation"))
    systems = [regulator]
    if network is not None:
        add_network(builder, regulator, network)
        systems.append(network)
    for system in systems:
        for port in map(system.get_output_port, range(system.num_output_ports())):
            builder.ExportOutput(port, port.get_name())
    return build(builder, "control")
