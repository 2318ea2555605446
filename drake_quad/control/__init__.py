"""Controllers: position, estimators, fuzzy networks that learn, thrust vectoring, attitude, the cascade of them."""

from drake_quad.control.attitude import AttitudeController, AttitudeNumbers
from drake_quad.control.axes import PerAngle, PerAxis
from drake_quad.control.cascade import build_cascade
from drake_quad.control.disturbance.estimator import DisturbanceEstimator, EstimatorNumbers
from drake_quad.control.disturbance.laws import AdaptiveLaw, IncrementalLaw, KalmanLaw
from drake_quad.control.disturbance.tilt import TiltDisturbanceEstimator, TiltEstimatorNumbers
from drake_quad.control.fuzzy.adaptation import AdaptationRates
from drake_quad.control.fuzzy.inference import Antecedents, FuzzySets
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, Limits, SignLaw
from drake_quad.control.fuzzy.set_learning import AdaptationNumbers, SetLearning
from drake_quad.control.fuzzy.systems import FuzzyRules, LearningNumbers, WeightLearning, build_fuzzy_network
from drake_quad.control.geometric import (
    GeometricAttitudeController,
    IntegratingAttitudeController,
    IntegratingAttitudeNumbers,
)
from drake_quad.control.incremental_attitude import IncrementalAttitudeController, IncrementalAttitudeNumbers
from drake_quad.control.integral import IntegralCorrection, IntegralGains
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring, VectoringNumbers

__all__ = [
    "AdaptationNumbers",
    "AdaptationRates",
    "AdaptiveLaw",
    "Antecedents",
    "AttitudeController",
    "AttitudeNumbers",
    "CovarianceLaw",
    "DisturbanceEstimator",
    "EstimatorNumbers",
    "FuzzyRules",
    "FuzzySets",
    "GeometricAttitudeController",
    "GradientLaw",
    "IncrementalAttitudeController",
    "IncrementalAttitudeNumbers",
    "IncrementalLaw",
    "IntegralCorrection",
    "IntegralGains",
    "IntegratingAttitudeController",
    "IntegratingAttitudeNumbers",
    "KalmanLaw",
    "LearningNumbers",
    "Limits",
    "PdGains",
    "PerAngle",
    "PerAxis",
    "ProportionalDerivative",
    "SetLearning",
    "SignLaw",
    "ThrustLimits",
    "ThrustVectoring",
    "TiltDisturbanceEstimator",
    "TiltEstimatorNumbers",
    "VectoringNumbers",
    "WeightLearning",
    "build_cascade",
    "build_fuzzy_network",
    "build_position_controller",
]
