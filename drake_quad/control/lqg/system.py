"""Linear-quadratic-Gaussian control as a system."""

from typing import Any, Literal

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.control.cascade import put_around
from drake_quad.control.lqg import laws
from drake_quad.control.lqg.laws import ChainCommands, Deviations, Estimate, KalmanState, LqgNumbers, Regulated, Sent
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

Carried = Literal["wrench", "attitude_target"]


def _asked(
    reference: Reference,
    jerk: Jerk,
    snap: Snap,
    correction: Acceleration | None,
    perturbation: ChainCommands | None,
    tick: float,
    *remembered: Any,
) -> tuple[Estimate, Regulated]:
    """The estimate of now, and what the regulator makes of it; before the first frame the snap has not changed."""
    _, before, sent, _, numbers, *_ = remembered
    estimate = laws.estimated(*remembered)
    if sent.snap is not None:
        sent = sent._replace(snap=where(before.begun != 0.0, sent.snap, snap))
    return estimate, laws.regulated(estimate, reference, jerk, snap, sent, correction, perturbation, numbers, tick)


def _wrench(reference: Reference, jerk: Jerk, snap: Snap, *reads: Any) -> Wrench:
    estimate, asked = _asked(reference, jerk, snap, *reads)
    _, _, _, measurement, _, _, _, numbers, *_ = reads
    return laws.wrench_for(asked, estimate, measurement, reference, jerk, snap, numbers)


def _target(reference: Reference, jerk: Jerk, snap: Snap, *reads: Any) -> AttitudeTarget:
    estimate, asked = _asked(reference, jerk, snap, *reads)
    _, _, _, measurement, _, _, _, numbers, *_ = reads
    return laws.target_for(asked, estimate, measurement, reference, numbers)


def _acceleration(*reads: Any) -> Acceleration:
    _, asked = _asked(*reads)
    return asked.acceleration


def _sent(reference: Reference, jerk: Jerk, snap: Snap, *reads: Any) -> Sent:
    _, asked = _asked(reference, jerk, snap, *reads)
    _, _, _, _, _, sent, *_ = reads
    return laws.sent_after(asked, snap, sent)


def _deviation(
    reference: Reference, jerk: Jerk, snap: Snap, correction: Acceleration | None, *remembered: Any
) -> Deviations:
    _, _, sent, *_ = remembered
    return laws.fed_back_of(laws.estimated(*remembered), reference, jerk, snap, sent, correction)


def _error(reference: Reference, *remembered: Any) -> PositionError:
    return laws.error_of(laws.estimated(*remembered), reference)


def _error_rate(reference: Reference, *remembered: Any) -> PositionErrorRate:
    return laws.error_rate_of(laws.estimated(*remembered), reference)


def _pd(reference: Reference, *remembered: Any) -> Acceleration:
    _, _, _, _, numbers, *_ = remembered
    estimate = laws.estimated(*remembered)
    error, rate = laws.error_of(estimate, reference), laws.error_rate_of(estimate, reference)
    return laws.outer_feedback(error, rate, numbers)


def _disturbance(*remembered: Any) -> Acceleration:
    return laws.disturbance_of(laws.estimated(*remembered))


def _none(numbers: LqgNumbers) -> Acceleration:
    return Acceleration(0.0, 0.0, 0.0)


def deviations_of(numbers: LqgNumbers) -> Layout:
    """The layout of what the port `deviation` holds."""
    lateral, vertical = ((*loop.K, *loop.K_pending) for loop in (numbers.lateral, numbers.vertical))
    return layout_of(Deviations, Deviations(lateral, lateral, vertical, _none(numbers)))


def _first(numbers: LqgNumbers) -> KalmanState:
    lateral, vertical = ([type(loop.K)(*[0.0] * len(loop.K))] for loop in (numbers.lateral, numbers.vertical))
    return KalmanState(Estimate(*lateral, *lateral, *vertical), 0.0, 0.0)


@fleet_system(float, AutoDiffXd)
class LinearQuadraticGaussian(FleetSystem):
    """A Kalman filter and a linear-quadratic regulator in place of the whole cascade.

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

    The filter is updated at every frame; what is commanded at a tick follows from it, see `drake_quad.control.lqg.laws`
    for the equations and `drake_quad.control.lqg.chains` for the model. With an autopilot there is an `attitude_target`
    in place of the `wrench`. `error` and `error_rate` are those of the estimate; `pd` is what the regulator makes of
    them, as an outer loop would; `acceleration_command` is a_r + `pd` less what stands against disturbances, within
    limits. `disturbance` is the estimate of the disturbing acceleration.

    The ports `correction` and `learned_disturbance` are there if a network is around the controller. The first is an
    acceleration that is subtracted from what is commanded; the second is a known disturbance to the filter from the
    next frame on, so that `disturbance` is only the rest, and the other outputs follow from it without an algebraic
    loop. They differ by the network's lead.

    The port `perturbation` is there if something else than the regulator keeps the tilt within its limits, which it
    follows from `deviation`, what the regulator feeds back: it is added to the commands, see
    `drake_quad.control.mpc.system`.

    The states are `filter`, `sent` and, with the port, `known`. The only parameter of the context is `numbers`.

    Args:
        num_vehicles: N.
        signal: that the link carries.
        period: h of the frames, s.
        tick: of the control, s; a whole number of frames.
        loses_frames: whether a frame whose x is that of the one before to the bit is taken for a lost one.
        takes_correction: whether there are the ports `correction` and `learned_disturbance`.
        takes_perturbation: whether there are the ports `perturbation` and `deviation`.
        numbers: of the controller.
    """

    def declare(
        self,
        *,
        signal: Carried = "wrench",
        period: float = 0.01,
        tick: float = 0.02,
        loses_frames: bool = False,
        takes_correction: bool = False,
        takes_perturbation: bool = False,
        numbers: LqgNumbers,
    ) -> None:
        """Declares the system."""
        measurement, reference = self.input("measurement"), self.input("reference")
        jerk = self.input("reference_jerk", absent=Jerk(0.0, 0.0, 0.0))
        snap = self.input("reference_snap", absent=Snap(0.0, 0.0, 0.0, 0.0))
        parameter = self.parameter("numbers", lambda numbers: numbers)
        before, sent = self.state("filter", _first), self.state("sent", Sent.hovering)
        correction = known = perturbation = None
        if takes_correction:
            correction = self.input("correction", absent=Acceleration(0.0, 0.0, 0.0))
            known = self.state("known", _none)
            learned = self.input("learned_disturbance", absent=Acceleration(0.0, 0.0, 0.0))
            self.update(period, identity, learned, writes=[known])
        if takes_perturbation:
            perturbation = self.input("perturbation", layout=layout_of(ChainCommands))
        remembered = measurement, before, sent, known, parameter, period, loses_frames
        wanted = reference, jerk, snap, correction, perturbation, tick, *remembered
        self.update(period, laws.filter_after, *remembered, writes=[before])
        self.update(tick, _sent, *wanted, writes=[sent])
        if signal == "wrench":
            self.output("wrench", _wrench, *wanted)
        else:
            self.output("attitude_target", _target, *wanted)
        self.output("acceleration_command", _acceleration, *wanted)
        self.output("error", _error, reference, *remembered)
        self.output("error_rate", _error_rate, reference, *remembered)
        self.output("pd", _pd, reference, *remembered)
        self.output("disturbance", _disturbance, *remembered)
        if takes_perturbation:
            fed_back = reference, jerk, snap, correction, *remembered
            self.output("deviation", _deviation, *fed_back, layout=deviations_of(numbers))


def build_lqg_control(regulator: Any, network: Any = None, programme: Any = None) -> Diagram:
    """Build the diagram `control`, which contains the controller and the systems around it.

    Args:
        regulator: a `LinearQuadraticGaussian`, which takes a correction if there is a network, and a perturbation if
            there is a programme.
        network: network around the controller, if any.
        programme: `PredictiveProgramme` that keeps the controller within its limits, if any.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("regulator", regulator)
    for port in map(regulator.get_input_port, range(regulator.num_input_ports())):
        if port.get_name() not in ("correction", "learned_disturbance", "perturbation"):
            builder.ExportInput(port, port.get_name())
    if programme is not None:
        perturbation = append(builder, "programme", programme, regulator.GetOutputPort("deviation"))
        builder.Connect(perturbation, regulator.GetInputPort("perturbation"))
    shown = [regulator]
    if network is not None:
        put_around(builder, regulator, network)
        shown.append(network)
    for system in shown:
        for port in map(system.get_output_port, range(system.num_output_ports())):
            builder.ExportOutput(port, port.get_name())
    return build(builder, "control")
