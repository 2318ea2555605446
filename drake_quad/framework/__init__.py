"""Declared systems for fleets, and their formulas, from Python to machine code."""

from drake_quad.framework.fleet_system import TIME, AutoDiffXd, Expression, FleetSystem, fleet_system
from drake_quad.framework.wiring import split_output, subsystem

__all__ = ["TIME", "AutoDiffXd", "Expression", "FleetSystem", "fleet_system", "split_output", "subsystem"]
