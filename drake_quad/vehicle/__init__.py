"""The aircraft: parameters, rigid body and rotors, allocation, autopilot."""

from drake_quad.vehicle.allocation import Allocation, RotorModel
from drake_quad.vehicle.autopilot import AttitudeAutopilot, AutopilotNumbers, Gyroscope, LoopGains
from drake_quad.vehicle.faults import RotorFaults, SpeedFactors
from drake_quad.vehicle.parameters import CentreOfMass, Inertia, QuadrotorParameters, ThrustFactors
from drake_quad.vehicle.quadrotor import Place, Quadrotor, QuadrotorNumbers
from drake_quad.vehicle.responding import (
    AttitudeResponse,
    DampingRatios,
    NaturalFrequencies,
    RespondingNumbers,
    RespondingQuadrotor,
)

__all__ = [
    "Allocation",
    "AttitudeAutopilot",
    "AttitudeResponse",
    "AutopilotNumbers",
    "CentreOfMass",
    "DampingRatios",
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
    "RotorFaults",
    "RotorModel",
    "SpeedFactors",
    "ThrustFactors",
]
