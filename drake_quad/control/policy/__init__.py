"""Policies: networks that were trained, what they see, and what their actions mean."""

from drake_quad.control.policy.actions import AccelerationScale, AttitudeScale, RatesScale, SpeedScale
from drake_quad.control.policy.network import Dense, Gru, Network
from drake_quad.control.policy.observation import ObservationNumbers, ObservationSpec
from drake_quad.control.policy.systems import Actuation, Observation, Policy, build_policy_control

__all__ = [
    "AccelerationScale",
    "Actuation",
    "AttitudeScale",
    "Dense",
    "Gru",
    "Network",
    "Observation",
    "ObservationNumbers",
    "ObservationSpec",
    "Policy",
    "RatesScale",
    "SpeedScale",
    "build_policy_control",
]
