"""Meshcat visualizer of a quadrotor in a simulated diagram."""

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
from drake_quad.visualization.places import places
from drake_quad.visualization.replay.scene import draw_surroundings, wind_blows_elsewhere
from drake_quad.visualization.replay.shapes import (
    TRAIL_PIECE,
    Frame,
    draw_arrow,
    draw_quadrotor,
    draw_trail_piece,
    pose_of,
    rotor_poses,
    shrunk,
    turned_by,
    wind_arrow,
)
from drake_quad.visualization.style import BLACK, VERMILION

_FRAME = 1.0 / 32.0  # s, the publish period of Drake's MeshcatVisualizer


class QuadrotorVisualizer(LeafSystem):
    """Meshcat visualizer of one quadrotor, for any diagram.

    It draws the vehicle 32 times a second, and the trail that the vehicle leaves. A Meshcat recording contains the
    poses of all frames, but shows the whole trail at any time. Input ports, of which all but `state` may be
    unconnected:

    - `state` (12 rows): x, y, z in m, roll, pitch, yaw in rad, and rates, which are not used.
    - `rotor_speed` (4 rows): in rad/s; the rotors turn at a tenth of it, so that their motion is visible.
    - `reference` (11 rows): a point is drawn at its x, y, z in m.
    - `wind` (3 rows): velocity of the air in m/s; an arrow above the vehicle shows it.

    Args:
        meshcat: server that shows the scene.
        scenario: scenario whose vehicle is drawn; of a scenario with distributions, its sample.
        plan: plan whose path is drawn, with the floor, obstacles and fans of the scenario around it, and to which the
            camera turns; None to draw nothing but the vehicle.
        name: name of the vehicle, a path in the scene; two vehicles in one scene need different names.
    """

    def __init__(
        self, meshcat: Meshcat, scenario: Scenario, plan: Plan | None = None, *, name: str = "vehicle"
    ) -> None:
        super().__init__()
        drawn = draw_sample(scenario, scenario.sample or 0)
        frame = Frame.of(drawn.vehicle)
        self._meshcat, self._path, self._rotors = meshcat, f"/{name}", frame.rotors
        self._size = shrunk(frame.rotors)
        for signal in ("state", "rotor_speed", "reference", "wind"):
            self.DeclareVectorInputPort(signal, len(SIGNALS[signal]._fields))
        # The jets of fans are drawn, so only other wind needs an arrow.
        self._shown = ["state", "rotor_speed", "reference", *(["wind"] if wind_blows_elsewhere(scenario) else [])]
        self.DeclarePeriodicPublishEvent(_FRAME, 0.0, self._show)
        if plan is not None:
            draw_surroundings(meshcat, drawn, plan, np.empty((0, 3)))
        draw_quadrotor(meshcat, self._path, frame, BLACK)
        self._last = -np.inf  # time of the last frame, s
        self._angles = np.zeros(4)
        self._trail: list[np.ndarray] = []
        self._pieces = 0

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
            scenario: scenario whose vehicle is drawn.
            sources: systems in the builder. Each input port is connected to the first of them with an output port of
                its name: for example a laboratory, which has `state`, `rotor_speed` and `wind`, and a reference. `wind`
                stays unconnected if all wind of the scenario comes from fans, whose jets are drawn.
            plan: as for the class.
            name: as for the class.

        Raises:
            RuntimeError: an output port is not of one vehicle.
        """
        visualizer = builder.AddNamedSystem(f"{name}_visualizer", cls(meshcat, scenario, plan, name=name))
        for signal in visualizer._shown:
            source = next((each for each in sources if each.HasOutputPort(signal)), None)
            if source is not None:
                builder.Connect(source.GetOutputPort(signal), visualizer.GetInputPort(signal))
        return visualizer

    def watch(self, simulator: Simulator) -> None:
        """Show the simulation of a diagram that is already built, through the monitor of its simulator.

        Args:
            simulator: simulator of a diagram with the output port `state`, and perhaps the others, that belongs to no
                diagram with this visualizer.
        """
        diagram, own = simulator.get_system(), self.CreateDefaultContext()
        signals = [signal for signal in self._shown if diagram.HasOutputPort(signal)]

        def show(context: Context) -> EventStatus:
            if self._last <= context.get_time() < self._last + _FRAME - 1e-9:
                return EventStatus.DidNothing()
            own.SetTime(context.get_time())
            for signal in signals:
                self.GetInputPort(signal).FixValue(own, diagram.GetOutputPort(signal).Eval(context))
            return self._show(own)

        simulator.set_monitor(show)

    def _show(self, context: Context) -> EventStatus:
        """Draw a frame."""
        time, state = context.get_time(), State(*self.GetInputPort("state").Eval(context))
        if time < self._last:
            self._forget()
        elapsed = time - self._last if np.isfinite(self._last) else 0.0
        self._last = time
        self._meshcat.SetTransform(self._path, pose_of(state), time)
        if (rotor_speed := self._signal("rotor_speed", context)) is not None:
            self._angles += turned_by(self._rotors, rotor_speed, elapsed)
            for number, pose in enumerate(rotor_poses(self._rotors, self._angles), start=1):
                self._meshcat.SetTransform(f"{self._path}/rotor_{number}", pose, time)
        if (reference := self._signal("reference", context)) is not None:
            path = f"{self._path}_reference"
            if not self._meshcat.HasPath(path):
                self._meshcat.SetObject(path, Sphere(self._size * 0.04))
            self._meshcat.SetTransform(path, RigidTransform(places(reference)), time)
        if (wind := self._signal("wind", context)) is not None:
            path = f"{self._path}_wind"
            if not self._meshcat.HasPath(path):
                draw_arrow(self._meshcat, f"{path}/arrow")
            pose, scale = wind_arrow(wind, state)
            self._meshcat.SetTransform(path, pose, time)
            self._meshcat.SetProperty(f"{path}/arrow", "scale", scale, time)
        self._leave_trail(places(state))
        return EventStatus.Succeeded()

    def _leave_trail(self, place: np.ndarray) -> None:
        self._trail.append(place)
        if len(self._trail) * _FRAME > TRAIL_PIECE:
            path = f"{self._path}_trail/{self._pieces}"
            draw_trail_piece(self._meshcat, path, np.array(self._trail), VERMILION, self._size)
            self._trail, self._pieces = self._trail[-1:], self._pieces + 1

    def _forget(self) -> None:
        """Delete the trail of the previous simulation."""
        self._meshcat.Delete(f"{self._path}_trail")
        self._last, self._trail, self._pieces = -np.inf, [], 0

    def _signal(self, name: str, context: Context) -> Any:
        """Return a signal with its rows by name; None if its port is not connected."""
        port = self.GetInputPort(name)
        return SIGNALS[name](*port.Eval(context)) if port.HasValue(context) else None
