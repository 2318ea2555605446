"""What surrounds the vehicle: motion capture, command link, wind, and the referee of a flight."""

from drake_quad.laboratory.command_link import CommandLink, LinkNumbers
from drake_quad.laboratory.flight_monitor import CrashLimits, FlightMonitor, Window
from drake_quad.laboratory.laboratory import build_laboratory
from drake_quad.laboratory.metrics import Metrics
from drake_quad.laboratory.motion_capture import CameraNumbers, MotionCapture
from drake_quad.laboratory.wind.dryden import DrydenTurbulence, PerDirection, Turbulence, TurbulenceNumbers
from drake_quad.laboratory.wind.fans import Direction, Fans, Jet, Outlet
from drake_quad.laboratory.wind.gust import Gust, GustNumbers
from drake_quad.laboratory.wind.sine import SineNumbers, SineWind
from drake_quad.laboratory.wind.wind import SteadyWind, build_wind

__all__ = [
    "CameraNumbers",
    "CommandLink",
    "CrashLimits",
    "Direction",
    "DrydenTurbulence",
    "Fans",
    "FlightMonitor",
    "Gust",
    "GustNumbers",
    "Jet",
    "LinkNumbers",
    "Metrics",
    "MotionCapture",
    "Outlet",
    "PerDirection",
    "SineNumbers",
    "SineWind",
    "SteadyWind",
    "Turbulence",
    "TurbulenceNumbers",
    "Window",
    "build_laboratory",
    "build_wind",
]
