"""The aircraft: parameters, rigid body and rotors, what acts on them, allocation."""

from drake_quad.vehicle.allocation import Allocation, RotorModel
from drake_quad.vehicle.effects import Effects
from drake_quad.vehicle.faults import RotorFaults, SpeedFactors
from drake_quad.vehicle.parameters import CentreOfMass, Inertia, QuadrotorParameters
from drake_quad.vehicle.quadrotor import Place, Quadrotor, QuadrotorNumbers
from drake_quad.vehicle.rotors import Rotor, Rotors

__all__ = [
    "Allocation",
    "CentreOfMass",
    "Effects",
    "Inertia",
    "Place",
    "Quadrotor",
    "QuadrotorNumbers",
    "QuadrotorParameters",
    "Rotor",
    "RotorFaults",
    "RotorModel",
    "Rotors",
    "SpeedFactors",
]
