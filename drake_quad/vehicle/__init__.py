"""The aircraft: parameters, rigid body and rotors, what acts on them, allocation, autopilot."""

from drake_quad.vehicle.allocation import Allocation, RotorModel
from drake_quad.vehicle.autopilot import AttitudeAutopilot, AutopilotNumbers, Gyroscope, LoopGains
from drake_quad.vehicle.effects import Effects
from drake_quad.vehicle.faults import RotorFaults, SpeedFactors
from drake_quad.vehicle.parameters import CentreOfMass, Inertia, QuadrotorParameters
from drake_quad.vehicle.quadrotor import Place, Quadrotor, QuadrotorNumbers
from drake_quad.vehicle.responding import (
    AttitudeResponse,
    DampingRatios,
    NaturalFrequencies,
    RespondingNumbers,
    RespondingQuadrotor,
)
from drake_quad.vehicle.rotors import Rotor, Rotors

__all__ = [
    "Allocation",
    "AttitudeAutopilot",
    "AttitudeResponse",
    "AutopilotNumbers",
    "CentreOfMass",
    "DampingRatios",
    "Effects",
    "Gyroscope",
    "Inertia",
    "LoopGains",
    "NaturalFrequencies",
    "Place",
    "Quadrotor",
    "QuadrotorNumbers",
    "QuadrotorParameters",
    "RespondingNumbers",
    "RespondingQuadrotor",
    "Rotor",
    "RotorFaults",
    "RotorModel",
    "Rotors",
    "SpeedFactors",
]
