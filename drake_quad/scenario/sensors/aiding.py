"""Properties of sensors whose readings correct the estimate of a state estimator."""

from typing import Any, ClassVar, NamedTuple

import numpy as np

from drake_quad.scenario.quantities import can_differ_from_zero


class AidingModel(NamedTuple):
    """Way in which the readings of a sensor correct an estimate.

    Attributes:
        kind: type of the readings, a name in `drake_quad.estimation.corrections.AIDING_LAWS`.
        noise: names of settings for each component of a reading. The root sum of squares of these settings is the
            standard deviation of the component. Settings with three numbers describe three components.
    """

    kind: str
    noise: tuple[tuple[str, ...], ...]


class AidingSensor:
    """Sensor whose readings can correct an estimate.

    A class whose `aids` is not None must define the method `aiding_parameters`. The argument of this method is a tuple
    with the standard deviation of each component of a reading. It returns the parameters of the measurement equation.

    Attributes:
        aids: way in which the readings correct an estimate; None if they cannot.
    """

    aids: ClassVar[AidingModel | None] = None

    @property
    def mounting_position(self) -> tuple[Any, Any, Any] | None:
        """Position of the sensor in B relative to the origin of the layout, m; None if readings do not depend on it."""
        return getattr(self, "position", None)

    @property
    def num_components(self) -> int:
        """Number of components of a reading that have a standard deviation of their own."""
        return len(self._noise_settings())

    def reading_deviations(self) -> tuple[Any, ...]:
        """Return the standard deviation of each component of a reading; items may be (N,) arrays."""
        return tuple([np.sqrt(sum(np.square(each) for each in parts)) for parts in self._noise_settings()])

    def lacks_noise(self) -> bool:
        """Return whether a component of the readings has no noise at all."""
        return not all(any(map(can_differ_from_zero, parts)) for parts in self._noise_settings())

    def _noise_settings(self) -> list[tuple[Any, ...]]:
        """Return the values of the settings that determine the noise of each component."""
        assert self.aids is not None
        components: list[tuple[Any, ...]] = []
        for names in self.aids.noise:
            values = [getattr(self, name) for name in names]
            components += zip(*values, strict=True) if isinstance(values[0], tuple) else [tuple(values)]
        return components
