"""Tests that attributes and methods of every kind of layout, including a user's kind, agree with the geometry."""

from typing import ClassVar, Literal

import numpy as np
import pytest

from drake_quad import InputError, load_mission
from drake_quad.scenario.layouts import LAYOUTS, RotorLayout, arm_length_of, arm_length_range, rotors_of
from drake_quad.scenario.models import Nominal
from drake_quad.scenario.schema import file_schema
from drake_quad.vehicle.rotors import Rotor, Rotors

ROTOR_POSITIONS = [[0.14, 0.01, 0.02], [-0.01, -0.16, 0.0], [-0.13, 0.02, 0.0], [0.02, 0.15, 0.01]]
ALTERNATING_DIRECTIONS = ("clockwise", "anticlockwise")
LAYOUT_FIELDS = {
    "plus": [{}, {"length": 0.3, "width": 0.4}],
    "x": [{}, {"length": 0.3, "width": 0.4, "rotor_1_turns": "anticlockwise"}],
    "h": [{"length": 0.3, "width": 0.4}],
    "rotors": [
        {
            "rotors": [
                {"position": position, "turns": ALTERNATING_DIRECTIONS[i % 2]}
                for i, position in enumerate(ROTOR_POSITIONS)
            ]
        }
    ],
}


class DiamondLayout(RotorLayout):
    """Plus layout that is half as long as it is wide."""

    kind: Literal["diamond"]
    is_paired: ClassVar = True
    has_side_bars: ClassVar = False
    has_distances: ClassVar = False

    def rotors_of(self, airframe):
        """Return the rotors of an airframe."""
        b, d, arm = airframe.thrust_factor, airframe.drag_factor, airframe.arm_length
        positions = (0.5 * arm, 0.0), (0.0, -arm), (-0.5 * arm, 0.0), (0.0, arm)
        return Rotors._make(Rotor(x, y, 0.0, 2.0 * (i % 2) - 1.0, b, d) for i, (x, y) in enumerate(positions))


def check_member(kind, fields):
    airframe = Nominal.model_validate({"layout": {"kind": kind, **fields}})
    layout, rotors = airframe.layout, np.array(rotors_of(airframe))
    opposite = np.abs(rotors[:2, :3] + rotors[2:, :3]).max() < 1e-15
    assert layout.is_paired == (opposite and (rotors[:2, 3:] == rotors[2:, 3:]).all())
    distances = np.hypot(rotors[:, 0], rotors[:, 1])
    if layout.has_distances:
        assert arm_length_range(airframe) == pytest.approx([distances.min(), distances.max()])
        assert arm_length_of(airframe) == pytest.approx(0.5 * (distances.min() + distances.max()))
    else:
        longer = np.array(rotors_of(airframe.model_copy(update={"arm_length": 2.0 * airframe.arm_length})))
        np.testing.assert_allclose(longer[:, :3], 2.0 * rotors[:, :3], rtol=1e-14)


@pytest.mark.parametrize(
    ("kind", "fields"), [(kind, fields) for kind in LAYOUTS.members for fields in LAYOUT_FIELDS.get(kind, [{}])]
)
def test_attributes_of_every_layout_agree_with_its_geometry(kind, fields):
    check_member(kind, fields)


@pytest.mark.slow
def test_a_user_s_layout_is_checked_and_part_of_the_language():
    with pytest.raises(InputError, match=r"nominal.layout.kind is 'diamond', but must be one of"):
        load_mission("hover", {"nominal.layout": {"kind": "diamond"}})
    LAYOUTS.register(DiamondLayout)
    check_member("diamond", {})
    assert rotors_of(load_mission("hover", {"nominal.layout": {"kind": "diamond"}}).nominal).rotor_2.y == -0.17
    assert "DiamondLayout" in file_schema()["$defs"]
