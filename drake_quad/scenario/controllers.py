"""Position controllers of the scenario language."""

from typing import Annotated, Literal

from pydantic import Field

from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import Gains, Positive


class PdPosition(Model):
    """PD on the position error, eq (8)."""

    kind: Literal["pd"]
    k_p: Gains = Field(description="k_P on X, Y, Z (1/s²)")
    k_d: Gains = Field(description="k_D on X, Y, Z (1/s)")
    derivative: Literal["tracking_error", "measurement"] = Field(
        default="tracking_error", description="what k_D multiplies: v_r - v, or -v"
    )
    feed_forward: Literal["none", "acceleration", "jerk", "snap"] = Field(
        default="none", description="up to which derivative of the reference is fed forward"
    )


class PidPosition(PdPosition):
    """PD with an integral, which is held within a limit against windup."""

    kind: Literal["pid"]  # type: ignore[assignment]
    k_i: Gains = Field(description="k_I on X, Y, Z (1/s³)")
    integral_limit: Positive = Field(
        default=2.0, description="largest acceleration that the integral may ask for (m/s²)"
    )


PositionController = Annotated[PdPosition | PidPosition, Field(discriminator="kind")]
