"""Positions, directions of rotation, and thrust and drag factors of the four rotors."""

from typing import Annotated, NamedTuple

from drake_quad.signals import Number, Quantity, Row

Length = Annotated[Row, Quantity("m", "B")]
ThrustFactor = Annotated[Row, Quantity("N s²", sign="positive")]
DragFactor = Annotated[Row, Quantity("N m s²", sign="nonnegative")]

# Directions of rotation of a rotor, seen from above.
CLOCKWISE = -1.0
ANTICLOCKWISE = 1.0


class Rotor(NamedTuple):
    """Rotor whose thrust is along z of B.

    Attributes:
        x: forward coordinate relative to the origin of the layout, which is the centre of a plus or an x.
        y: coordinate to the left, relative to the same origin.
        z: upward coordinate, relative to the same origin.
        direction: direction of rotation seen from above, 1 for anticlockwise and -1 for clockwise.
        thrust_factor: b, ratio of thrust to squared speed.
        drag_factor: d, ratio of torque to squared speed.
    """

    x: Length
    y: Length
    z: Length
    direction: Number
    thrust_factor: ThrustFactor
    drag_factor: DragFactor


class Rotors(NamedTuple):
    """The four rotors of a vehicle; values are numbers for one vehicle, or arrays for a fleet.

    `plus` and `x` number the rotors clockwise as seen from above, and neighbouring rotors turn in opposite directions.
    Default values are from the paper's Table I. The thrust factor in this table is large for an 8-inch propeller. It is
    kept because all results of the paper depend on it.
    """

    rotor_1: Rotor
    rotor_2: Rotor
    rotor_3: Rotor
    rotor_4: Rotor

    @classmethod
    def plus(
        cls,
        *,
        length: Row = 0.34,
        width: Row = 0.34,
        rotor_1_direction: float = CLOCKWISE,
        thrust_factor: Row = 4.13e-5,
        drag_factor: Row = 8.5e-7,
    ) -> "Rotors":
        """Return rotors 1 to 4 in front, to the right, at the back and to the left.

        Args:
            length: distance between the front and the rear rotor, m.
            width: distance between the right and the left rotor, m.
            rotor_1_direction: 1 if rotor 1 turns anticlockwise, -1 if clockwise.
            thrust_factor: thrust factor b, N s².
            drag_factor: drag factor d, N m s².
        """
        x, y = 0.5 * length, 0.5 * width
        positions = (x, 0.0), (0.0, -y), (-x, 0.0), (0.0, y)
        return cls._alternating(positions, rotor_1_direction, thrust_factor, drag_factor)

    @classmethod
    def x(
        cls,
        *,
        length: Row,
        width: Row,
        rotor_1_direction: float = CLOCKWISE,
        thrust_factor: Row = 4.13e-5,
        drag_factor: Row = 8.5e-7,
    ) -> "Rotors":
        """Return rotors 1 to 4 at the front right, rear right, rear left and front left.

        Args:
            length: distance between the front and the rear rotors, m.
            width: distance between the right and the left rotors, m.
            rotor_1_direction: 1 if rotor 1 turns anticlockwise, -1 if clockwise.
            thrust_factor: thrust factor b, N s².
            drag_factor: drag factor d, N m s².
        """
        x, y = 0.5 * length, 0.5 * width
        positions = (x, -y), (-x, -y), (-x, y), (x, y)
        return cls._alternating(positions, rotor_1_direction, thrust_factor, drag_factor)

    @classmethod
    def _alternating(
        cls, positions: tuple[tuple[Row, Row], ...], direction: float, thrust_factor: Row, drag_factor: Row
    ) -> "Rotors":
        """Return rotors at the given positions, in this order; neighbouring rotors turn in opposite directions."""
        directions = direction, -direction, direction, -direction
        return cls(
            *(
                Rotor(x, y, 0.0, direction, thrust_factor, drag_factor)
                for (x, y), direction in zip(positions, directions, strict=True)
            )
        )

    @property
    def thrust_factors(self) -> tuple[Row, ...]:
        """Thrust factors b of the four rotors."""
        return tuple([rotor.thrust_factor for rotor in self])

    def with_thrust_factors(self, b_1: Row, b_2: Row, b_3: Row, b_4: Row) -> "Rotors":
        """Return these rotors with other thrust factors."""
        factors = (b_1, b_2, b_3, b_4)
        return Rotors(*(rotor._replace(thrust_factor=b) for rotor, b in zip(self, factors, strict=True)))
