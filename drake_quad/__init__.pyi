"""Public names of the package, each with the module that defines it."""

from .assembly.registered_controllers import register_controller as register_controller
from .design.cascade import design_cascade as design_cascade
from .design.cascade import with_gains as with_gains
from .errors import InputError as InputError
from .export.controller import export_controller as export_controller
from .exported.system import exported_controller as exported_controller
from .fleets.study_fleet import StudyFleet as StudyFleet
from .flight.flight import Flight as Flight
from .flight.flight import read_flight as read_flight
from .flight.learned import save_network as save_network
from .flight.mission import build_laboratory_diagram as build_laboratory_diagram
from .flight.mission import build_tracking_diagram as build_tracking_diagram
from .flight.mission import build_vehicle as build_vehicle
from .flight.mission import plan_route as plan_route
from .flight.simulation import simulate as simulate
from .flight.simulation import simulate_samples as simulate_samples
from .identification.identify import identify as identify
from .identification.position_law.law import identify_position_law as identify_position_law
from .identification.results.vehicle_file import write_vehicle as write_vehicle
from .identification.validation.comparison import compare_with_log as compare_with_log
from .identification.validation.prediction import predict as predict
from .linear.closed_loop import closed_loop as closed_loop
from .linear.closed_loop import laboratory_plant as laboratory_plant
from .linear.link_margins import link_margins as link_margins
from .logs.reading import read_log as read_log
from .scenario.batch import draw_sample as draw_sample
from .scenario.files.loading import load_mission as load_mission
from .scenario.files.loading import load_scenario as load_scenario
from .scenario.files.loading import load_undesigned as load_undesigned
from .scenario.files.saving import save_scenario as save_scenario
from .scenario.metrics.metric import flight_metric as flight_metric
from .scenario.metrics.metric import metric as metric
from .scenario.models import Scenario as Scenario
from .statistics.estimates import mean_interval as mean_interval
from .studies.monte_carlo import run_monte_carlo as run_monte_carlo
from .studies.statistics import compare_studies as compare_studies
from .studies.study import Study as Study
from .studies.study import read_studies as read_studies
from .studies.study import read_study as read_study

__version__: str
from .worlds.language import load_world as load_world
from .worlds.simulation import WorldFlight as WorldFlight
from .worlds.simulation import simulate_world as simulate_world
from .worlds.simulation import simulate_worlds as simulate_worlds
from .worlds.world import World as World
