"""Payload."""

import math
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from drake_quad.framework.records import record_like
from drake_quad.scenario.effects.effect import EFFECTS, NO_OFFSET, PerAxis, VehicleEffect
from drake_quad.scenario.inertia import INERTIA_RULE, inertia_flaw
from drake_quad.scenario.quantities import Moment, Position, Positive, field_of
from drake_quad.signals import Row
from drake_quad.vehicle.payload import Payload


@EFFECTS.member
class PayloadEffect(VehicleEffect):
    """A mass that is fixed to the vehicle, and is picked up or dropped at a time."""

    mass: Positive = field_of(Payload, "mass", "of it")
    position: Position = Field(
        default=NO_OFFSET,
        description="of its centre of mass, x, y, z in B seen from that of the vehicle without it (m)",
    )
    inertia: PerAxis = Field(
        default=NO_OFFSET,
        description=f"about its own centre of mass along x, y, z of B (kg m²), 0 for a point{INERTIA_RULE}",
    )
    time: Moment = Field(description="of the event (s)")
    event: Literal["picked_up", "dropped"] = Field(
        description="what happens at that time: before it is picked up and after it is dropped it is not there"
    )
    field: ClassVar = "payload"
    meaning: ClassVar = "fixed to the vehicle, if any"
    record: ClassVar = Payload
    is_believed: ClassVar = False
    depends_on_time: ClassVar = True
    couples_axes: ClassVar = True
    belongs_to_airframe: ClassVar = False

    @model_validator(mode="after")
    def _is_rigid(self) -> "PayloadEffect":
        if flaw := inertia_flaw(self.inertia):
            raise self.wrong(flaw, "inertia")
        return self

    def numbers(self) -> Payload:
        """Return the payload with the times between which the vehicle carries it."""
        picked_up = self.event == "picked_up"
        return record_like(
            Payload, self, picked_up=self.time if picked_up else 0.0, dropped=math.inf if picked_up else self.time
        )

    def in_hover(self) -> VehicleEffect | None:
        """Return a payload that stays if the vehicle carries it at the start of the flight; None if it does not."""
        if (self.event == "dropped") == (self.time == 0.0):
            return None
        return self.model_copy(update={"time": 0.0, "event": "picked_up"})

    def symmetric(self) -> VehicleEffect:
        """Return the payload on the z axis of the vehicle."""
        return self.model_copy(update={"position": (0.0, 0.0, self.position[2])})

    def event_times(self) -> tuple[Row, ...]:
        """Return the time at which the payload is picked up or dropped, s."""
        return (self.time,)
