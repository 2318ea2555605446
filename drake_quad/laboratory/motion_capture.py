"""Motion capture: what the ground station sees of the vehicles."""

from typing import Any

from drake_quad.fleet import AutoDiffXd, FleetSystem, fleet_system


@fleet_system(float, AutoDiffXd)
class MotionCapture(FleetSystem):
    """Samples the state and holds it until the next frame.

    .. pydrake_system::

        name: MotionCapture
        input_ports:
        - state
        output_ports:
        - measurement

    Both ports have the 12 rows of the vehicle's `state`. A frame is taken at time zero, by an initialization event,
    and at every multiple of the period; it can be read from then on, but by the other discrete updates of that
    instant only at the next:

        frame  ●━━━━━━━━━━○●━━━━━━━━━━○●
               0          h            2h

    The only discrete-state group is the frame. This is an exact camera, for a laboratory without imperfections.

    Args:
        num_vehicles: N.
        period: of the frames, s; the paper's cameras run at 100 Hz.
    """

    def declare(self, *, num_vehicles: int = 1, period: float = 0.01) -> None:
        """Declares the system; see the class for the arguments."""
        self._state = self.input("state", 12)
        self._frame = self.discrete_state([0.0] * 12)
        self.DeclareInitializationDiscreteUpdateEvent(self._take_frame)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._take_frame)
        self.DeclareStateOutputPort("measurement", self._frame)

    def _take_frame(self, context: Any, discrete_state: Any) -> None:
        self.copy(discrete_state.get_mutable_vector(self._frame), self.EvalVectorInput(context, self._state))
