"""A Drake laboratory for quadrotor tracking control."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

__all__ = [
    "Flight",
    "InputError",
    "Scenario",
    "Study",
    "build_tracking_diagram",
    "load_scenario",
    "read_study",
    "run_monte_carlo",
    "save_network",
    "simulate",
]

if TYPE_CHECKING:
    from drake_quad.assembly.tracking import build_tracking_diagram
    from drake_quad.errors import InputError
    from drake_quad.flight import Flight, save_network, simulate
    from drake_quad.scenario import Scenario, load_scenario
    from drake_quad.studies import Study, read_study, run_monte_carlo
else:
    # Loaded when first used: Drake alone takes a second that whoever wants an error or a version would wait for.
    _HOMES = {
        "Flight": "flight",
        "InputError": "errors",
        "Scenario": "scenario",
        "Study": "studies",
        "build_tracking_diagram": "assembly.tracking",
        "load_scenario": "scenario",
        "read_study": "studies",
        "run_monte_carlo": "studies",
        "save_network": "flight",
        "simulate": "flight",
    }

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        return globals()[name]

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
