"""A flight that is shown while it is flown."""

from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, Sphere
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, EventStatus

from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import draw_sample
from drake_quad.scenario.models import Scenario
from drake_quad.signals import SIGNALS, Reference, RotorSpeed, State, Wind
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

_FRAME = 1.0 / 30.0
_WHERE = "/vehicle"


class LiveView:
    """Shows the vehicle of a tracking diagram in Meshcat while a simulator flies it.

    It shows the state at the end of a step, which is a step old for a vehicle that steps in time.

    Args:
        meshcat: in which the vehicle is drawn.
        scenario: that is flown.
        plan: of the reference.
    """

    def __init__(self, meshcat: Meshcat, scenario: Scenario, plan: Plan) -> None:
        flown = draw_sample(scenario, scenario.sample or 0)
        frame = Frame.of(flown.vehicle)
        self._meshcat, self._rotors = meshcat, frame.rotors
        draw_surroundings(meshcat, flown, plan, np.empty((0, 3)))
        draw_quadrotor(meshcat, _WHERE, frame, BLACK)
        self._size = shrunk(frame.rotors)
        meshcat.SetObject("/reference/point", Sphere(self._size * 0.04))
        self._shows_wind = wind_blows_elsewhere(scenario)
        if self._shows_wind:
            draw_arrow(meshcat, f"{_WHERE}_wind/arrow")
        self._next, self._angles = 0.0, np.zeros(4)
        self._trail: list[np.ndarray] = []
        self._pieces = 0

    def watch(self, simulator: Simulator, rate: float) -> None:
        """Has a simulator show what it flies.

        Args:
            simulator: of a tracking diagram of one vehicle.
            rate: of real time; 0 for as fast as possible.
        """
        self._diagram = simulator.get_system()
        simulator.set_target_realtime_rate(rate)
        simulator.set_monitor(self._show)

    def _show(self, context: Context) -> EventStatus:
        time = context.get_time()
        if time < self._next:
            return EventStatus.DidNothing()
        self._next = time + _FRAME - 1e-9
        state: State = self._signal("state", context)
        reference: Reference = self._signal("reference", context)
        rotor_speed: RotorSpeed = self._signal("rotor_speed", context)
        self._meshcat.SetTransform(_WHERE, pose_of(state))
        self._meshcat.SetTransform("/reference", RigidTransform(places(reference)))
        self._angles += turned_by(self._rotors, rotor_speed, _FRAME)
        for number, pose in enumerate(rotor_poses(self._rotors, self._angles), start=1):
            self._meshcat.SetTransform(f"{_WHERE}/rotor_{number}", pose)
        if self._shows_wind:
            wind: Wind = self._signal("wind", context)
            pose, scale = wind_arrow(wind, state)
            self._meshcat.SetTransform(f"{_WHERE}_wind", pose)
            self._meshcat.SetProperty(f"{_WHERE}_wind/arrow", "scale", scale)
        self._trail.append(places(state))
        if len(self._trail) * _FRAME > TRAIL_PIECE:
            draw_trail_piece(
                self._meshcat, f"{_WHERE}_trail/{self._pieces}", np.array(self._trail), VERMILION, self._size
            )
            self._trail, self._pieces = self._trail[-1:], self._pieces + 1
        return EventStatus.Succeeded()

    def _signal(self, name: str, context: Context) -> Any:
        """A signal of the diagram, with its rows by name."""
        return SIGNALS[name](*self._diagram.GetOutputPort(name).Eval(context))
