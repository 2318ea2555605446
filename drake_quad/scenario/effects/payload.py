"""Payload in the scenario language."""

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from drake_quad.framework.records import record_like
from drake_quad.scenario.effects.effect import EFFECTS, NO_OFFSET, PerAxis, VehicleEffect
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, late_setting
from drake_quad.scenario.inertia import INERTIA_RULE, explain_invalid_inertia
from drake_quad.scenario.plausible import PLAUSIBLE_LOAD, PLAUSIBLE_SIZE
from drake_quad.scenario.quantities import Moment, Position, Positive, field_from_record
from drake_quad.signals import Row
from drake_quad.vehicle.payload import Payload


@EFFECTS.register
class PayloadEffect(VehicleEffect):
    """A mass fixed to the vehicle that is picked up or dropped during the flight."""

    mass: Annotated[Positive, PLAUSIBLE_LOAD] = field_from_record(Payload, "mass", "mass of the payload")
    position: Annotated[Position, PLAUSIBLE_SIZE] = Field(
        default=NO_OFFSET,
        description="centre of mass of the payload, x, y, z in B relative to the centre of mass of the empty vehicle"
        " (m)",
    )
    inertia: PerAxis = Field(
        default=NO_OFFSET,
        description="moments of inertia about the payload's centre of mass, on x, y, z of B (kg m²), 0 for a point"
        f" mass{INERTIA_RULE}",
    )
    time: Moment = Field(description="time of the event (s)")
    event: Literal["picked_up", "dropped"] = Field(
        description="event at this time; the vehicle carries the payload after picked_up, or until dropped"
    )
    field: ClassVar = "payload"
    description: ClassVar = "mass fixed to the vehicle for a part of the flight; none if not given"
    record: ClassVar = Payload
    is_nominal: ClassVar = False
    depends_on_time: ClassVar = True
    couples_axes: ClassVar = True
    belongs_to_airframe: ClassVar = False

    @model_validator(mode="after")
    def _is_rigid(self) -> "PayloadEffect":
        if flaw := explain_invalid_inertia(self.inertia):
            raise self.field_error(flaw, "inertia")
        return self

    def parameters(self) -> Payload:
        """Return the payload, with the times at which it is picked up and dropped."""
        picked_up = self.event == "picked_up"
        return record_like(
            Payload, self, picked_up=self.time if picked_up else 0.0, dropped=math.inf if picked_up else self.time
        )

    def in_hover(self) -> VehicleEffect | None:
        """Return the same payload without pick-up or drop, or None if the vehicle does not carry it at the start."""
        if (self.event == "dropped") == (self.time == 0.0):
            return None
        return self.model_copy(update={"time": 0.0, "event": "picked_up"})

    def symmetric(self) -> VehicleEffect:
        """Return the same payload, attached on the z axis of the vehicle."""
        return self.model_copy(update={"position": (0.0, 0.0, self.position[2])})

    def event_times(self) -> tuple[Row, ...]:
        """Return the time at which the payload is picked up or dropped, s."""
        return (self.time,)

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as an event after the flight."""
        yield from super().inactive_settings(flight, path)
        yield from late_setting(self, "time", flight, path)
