"""A flight while it is flown."""

from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, Sphere
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import EventStatus

from drake_quad.reference.plan import Plan
from drake_quad.scenario import Scenario
from drake_quad.visualization.replay.scene import draw_surroundings, wind_blows_elsewhere
from drake_quad.visualization.replay.shapes import (
    TRAIL_PIECE,
    draw_arrow,
    draw_quadrotor,
    draw_trail_piece,
    pose_of,
    rotor_poses,
    turned_by,
    wind_arrow,
)
from drake_quad.visualization.style import BLACK, VERMILION

_FRAME = 1.0 / 30.0
_WHERE = "/vehicle"


class LiveView:
    """Shows the vehicle of a tracking diagram in Meshcat while a simulator flies it.

    What is shown is the state at the end of a step; that of a vehicle with a time step is a step old.

    Args:
        meshcat: to show it in.
        scenario: that is flown.
        plan: the reference.
    """

    def __init__(self, meshcat: Meshcat, scenario: Scenario, plan: Plan) -> None:
        self._meshcat, self._arm_length = meshcat, scenario.nominal.arm_length
        draw_surroundings(meshcat, scenario, plan, np.empty((0, 3)))
        draw_quadrotor(meshcat, _WHERE, self._arm_length, BLACK)
        meshcat.SetObject("/reference/point", Sphere(0.04))
        self._shows_wind = wind_blows_elsewhere(scenario)
        if self._shows_wind:
            draw_arrow(meshcat, f"{_WHERE}_wind/arrow")
        self._next, self._angles = 0.0, np.zeros(4)
        self._trail: list[np.ndarray] = []
        self._pieces = 0

    def watch(self, simulator: Simulator, rate: float) -> None:
        """Has a simulator show what it flies, at a rate of real time; as fast as it can with 0."""
        self._diagram = simulator.get_system()
        simulator.set_target_realtime_rate(rate)
        simulator.set_monitor(self._show)

    def _show(self, context: Any) -> EventStatus:
        time = context.get_time()
        if time < self._next:
            return EventStatus.DidNothing()
        self._next = time + _FRAME - 1e-9
        state, reference, rotor_speed = (
            self._diagram.GetOutputPort(name).Eval(context) for name in ("state", "reference", "rotor_speed")
        )
        self._meshcat.SetTransform(_WHERE, pose_of(state))
        self._meshcat.SetTransform("/reference", RigidTransform(reference[0:3]))
        self._angles += turned_by(rotor_speed, _FRAME)
        for number, pose in enumerate(rotor_poses(self._arm_length, self._angles), start=1):
            self._meshcat.SetTransform(f"{_WHERE}/rotor_{number}", pose)
        if self._shows_wind:
            pose, scale = wind_arrow(self._diagram.GetOutputPort("wind").Eval(context), state)
            self._meshcat.SetTransform(f"{_WHERE}_wind", pose)
            self._meshcat.SetProperty(f"{_WHERE}_wind/arrow", "scale", scale)
        self._trail.append(state[0:3].copy())
        if len(self._trail) * _FRAME > TRAIL_PIECE:
            draw_trail_piece(self._meshcat, f"{_WHERE}_trail/{self._pieces}", np.array(self._trail), VERMILION)
            self._trail, self._pieces = self._trail[-1:], self._pieces + 1
        return EventStatus.Succeeded()
