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
    "closed_loop",
    "compare_studies",
    "compare_with_log",
    "design_cascade",
    "identify",
    "laboratory_plant",
    "link_margins",
    "load_scenario",
    "load_undesigned",
    "mean_interval",
    "predict",
    "read_flight",
    "read_log",
    "read_studies",
    "read_study",
    "run_monte_carlo",
    "save_network",
    "save_scenario",
    "simulate",
    "with_gains",
    "write_vehicle",
]

if TYPE_CHECKING:
    from drake_quad.analysis.cascade_design import design_cascade, with_gains
    from drake_quad.analysis.closed_loop import closed_loop, laboratory_plant
    from drake_quad.analysis.link_margins import link_margins
    from drake_quad.assembly.tracking import build_tracking_diagram
    from drake_quad.errors import InputError
    from drake_quad.flight import Flight, read_flight, save_network, simulate
    from drake_quad.identification.flown_again.comparison import compare_with_log
    from drake_quad.identification.flown_again.prediction import predict
    from drake_quad.identification.identify import identify
    from drake_quad.identification.logs.reading import read_log
    from drake_quad.identification.results.vehicle_file import write_vehicle
    from drake_quad.scenario import Scenario, load_scenario, load_undesigned, save_scenario
    from drake_quad.studies import Study, read_studies, read_study, run_monte_carlo
    from drake_quad.studies.statistics import compare_studies, mean_interval
else:
    # Loaded when first used: Drake alone takes a second that whoever wants an error or a version would wait for.
    _HOMES = {
        "Flight": "flight",
        "InputError": "errors",
        "Scenario": "scenario",
        "Study": "studies",
        "build_tracking_diagram": "assembly.tracking",
        "closed_loop": "analysis.closed_loop",
        "compare_studies": "studies.statistics",
        "compare_with_log": "identification.flown_again.comparison",
        "design_cascade": "analysis.cascade_design",
        "identify": "identification.identify",
        "laboratory_plant": "analysis.closed_loop",
        "link_margins": "analysis.link_margins",
        "load_scenario": "scenario",
        "load_undesigned": "scenario",
        "mean_interval": "studies.statistics",
        "predict": "identification.flown_again.prediction",
        "read_flight": "flight",
        "read_log": "identification.logs.reading",
        "read_studies": "studies",
        "read_study": "studies",
        "run_monte_carlo": "studies",
        "save_network": "flight",
        "save_scenario": "scenario",
        "simulate": "flight",
        "with_gains": "analysis.cascade_design",
        "write_vehicle": "identification.results.vehicle_file",
    }

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        return globals()[name]

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
