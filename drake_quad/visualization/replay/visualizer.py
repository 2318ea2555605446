"""Meshcat visualizer of a quadrotor in a simulation."""

from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, Sphere
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem

from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import draw_sample
from drake_quad.scenario.models import Scenario
from drake_quad.signals import SIGNALS, State
from drake_quad.visualization.positions import positions
from drake_quad.visualization.replay.scene import draw_surroundings, has_wind_besides_fans
from drake_quad.visualization.replay.shapes import (
    TRAIL_PIECE_DURATION,
    Frame,
    draw_arrow,
    draw_quadrotor,
    draw_trail_piece,
    part_scale,
    rotation_angles,
    rotor_poses,
    vehicle_pose,
    wind_arrow,
)
from drake_quad.visualization.style import BLACK, VERMILION

_FRAME_PERIOD = 1.0 / 32.0  # s, the publish period of Drake's MeshcatVisualizer


class QuadrotorVisualizer(LeafSystem):
    """Meshcat visualizer of one quadrotor, for any diagram.

    The vehicle and its trail are drawn 32 times per second. A Meshcat recording contains the poses of all frames, but
    shows the whole trail from the start.

    All input ports except `state` may be left unconnected:

    - `state` (12 components): position in m and attitude in rad; the velocities are not used.
    - `rotor_speed` (4 components): rotor speeds in rad/s. The drawn rotors turn ten times slower, so that their motion
      is visible.
    - `reference` (11 components): reference, whose position in m is drawn as a point.
    - `wind` (3 components): velocity of the air in m/s, which is drawn as an arrow above the vehicle.

    Args:
        meshcat: server that shows the scene.
        scenario: scenario with the vehicle that is drawn. If it has distributions, the vehicle of its sample is drawn.
        plan: plan with the path that is drawn and at which the camera is aimed. Floor, obstacles and fans of the
            scenario are drawn as well. None to draw only the vehicle.
        name: path of the vehicle in the scene; each vehicle in a scene needs a different path.
    """

    def __init__(
        self, meshcat: Meshcat, scenario: Scenario, plan: Plan | None = None, *, name: str = "vehicle"
    ) -> None:
        super().__init__()
        drawn = draw_sample(scenario, scenario.sample or 0)
        frame = Frame.of(drawn.vehicle)
        self._meshcat, self._path, self._rotors = meshcat, f"/{name}", frame.rotors
        self._scale = part_scale(frame.rotors)
        for signal in ("state", "rotor_speed", "reference", "wind"):
            self.DeclareVectorInputPort(signal, len(SIGNALS[signal]._fields))
        # The scene shows the jets of fans, so only other wind needs an arrow.
        self._used_signals = [
            "state",
            "rotor_speed",
            "reference",
            *(["wind"] if has_wind_besides_fans(scenario) else []),
        ]
        self.DeclarePeriodicPublishEvent(_FRAME_PERIOD, 0.0, self._show)
        if plan is not None:
            draw_surroundings(meshcat, drawn, plan, np.empty((0, 3)))
        draw_quadrotor(meshcat, self._path, frame, BLACK)
        self._last_time = -np.inf  # time of the last frame, s
        self._angles = np.zeros(4)
        self._trail: list[np.ndarray] = []
        self._num_pieces = 0

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        meshcat: Meshcat,
        scenario: Scenario,
        *sources: Any,
        plan: Plan | None = None,
        name: str = "vehicle",
    ) -> "QuadrotorVisualizer":
        """Add a visualizer to a builder, and connect its input ports to output ports of the same names.

        Args:
            builder: builder of a diagram.
            meshcat: server that shows the scene.
            scenario: scenario with the vehicle that is drawn.
            sources: systems in the builder, such as a laboratory and a reference. Each input port is connected to the
                first system that has an output port of the same name. `wind` stays unconnected if all wind of the
                scenario comes from fans, whose jets the scene shows.
            plan: plan, as for the class.
            name: name of the vehicle, as for the class.

        Raises:
            RuntimeError: if an output port belongs to more than one vehicle.
        """
        visualizer = builder.AddNamedSystem(f"{name}_visualizer", cls(meshcat, scenario, plan, name=name))
        for signal in visualizer._used_signals:
            source = next((each for each in sources if each.HasOutputPort(signal)), None)
            if source is not None:
                builder.Connect(source.GetOutputPort(signal), visualizer.GetInputPort(signal))
        return visualizer

    def watch(self, simulator: Simulator) -> None:
        """Show the simulation of an existing diagram, by setting the monitor of its simulator.

        Args:
            simulator: simulator of a diagram that does not contain this visualizer. The diagram has the output port
                `state`, and optionally output ports with the names of the other input ports.
        """
        diagram, context_of_visualizer = simulator.get_system(), self.CreateDefaultContext()
        signals = [signal for signal in self._used_signals if diagram.HasOutputPort(signal)]

        def show(context: Context) -> EventStatus:
            if self._last_time <= context.get_time() < self._last_time + _FRAME_PERIOD - 1e-9:
                return EventStatus.DidNothing()
            context_of_visualizer.SetTime(context.get_time())
            for signal in signals:
                self.GetInputPort(signal).FixValue(context_of_visualizer, diagram.GetOutputPort(signal).Eval(context))
            return self._show(context_of_visualizer)

        simulator.set_monitor(show)

    def _show(self, context: Context) -> EventStatus:
        """Draw a frame of the simulation."""
        time, state = context.get_time(), State(*self.GetInputPort("state").Eval(context))
        if time < self._last_time:
            self._delete_trail()
        elapsed = time - self._last_time if np.isfinite(self._last_time) else 0.0
        self._last_time = time
        self._meshcat.SetTransform(self._path, vehicle_pose(state), time)
        if (rotor_speed := self._signal_value("rotor_speed", context)) is not None:
            self._angles += rotation_angles(self._rotors, rotor_speed, elapsed)
            for number, pose in enumerate(rotor_poses(self._rotors, self._angles), start=1):
                self._meshcat.SetTransform(f"{self._path}/rotor_{number}", pose, time)
        if (reference := self._signal_value("reference", context)) is not None:
            path = f"{self._path}_reference"
            if not self._meshcat.HasPath(path):
                self._meshcat.SetObject(path, Sphere(self._scale * 0.04))
            self._meshcat.SetTransform(path, RigidTransform(positions(reference)), time)
        if (wind := self._signal_value("wind", context)) is not None:
            path = f"{self._path}_wind"
            if not self._meshcat.HasPath(path):
                draw_arrow(self._meshcat, f"{path}/arrow")
            pose, scale = wind_arrow(wind, state)
            self._meshcat.SetTransform(path, pose, time)
            self._meshcat.SetProperty(f"{path}/arrow", "scale", scale, time)
        self._extend_trail(positions(state))
        return EventStatus.Succeeded()

    def _extend_trail(self, position: np.ndarray) -> None:
        self._trail.append(position)
        if len(self._trail) * _FRAME_PERIOD > TRAIL_PIECE_DURATION:
            path = f"{self._path}_trail/{self._num_pieces}"
            draw_trail_piece(self._meshcat, path, np.array(self._trail), VERMILION, self._scale)
            self._trail, self._num_pieces = self._trail[-1:], self._num_pieces + 1

    def _delete_trail(self) -> None:
        """Delete the trail of the previous simulation."""
        self._meshcat.Delete(f"{self._path}_trail")
        self._last_time, self._trail, self._num_pieces = -np.inf, [], 0

    def _signal_value(self, name: str, context: Context) -> Any:
        """Return the value of an input port as a named tuple; None if the port is not connected."""
        port = self.GetInputPort(name)
        return SIGNALS[name](*port.Eval(context)) if port.HasValue(context) else None
