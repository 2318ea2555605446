from pathlib import Path

import pytest

from drake_quad import load_scenario
from drake_quad.vehicle.parameters import QuadrotorParameters

ROOT = Path(__file__).parent.parent


@pytest.fixture
def diagrams() -> Path:
    return ROOT / "diagrams"


@pytest.fixture(scope="session")
def asymmetric():
    """A scenario of tests/asymmetric.yaml, by its name and overrides."""
    return lambda name, *overrides: load_scenario(ROOT / "tests" / f"asymmetric.yaml:{name}", overrides)


@pytest.fixture(scope="session")
def asymmetric_vehicle() -> QuadrotorParameters:
    """A vehicle of which no two numbers are alike."""
    return QuadrotorParameters(
        mass=0.74,
        inertia=(0.0071, 0.0079, 0.0131),
        rotor_inertia=9.0e-5,
        thrust_factor=(4.15e-5, 4.02e-5, 4.17e-5, 4.12e-5),
        drag_factor=1.0e-6,
        arm_length=0.165,
        gravity=9.8,
        linear_drag=0.12,
        quadratic_drag=0.02,
        rotor_time_constant=0.04,
        min_rotor_speed=70.0,
        max_rotor_speed=290.0,
        centre_of_mass=(-0.003, 0.008),
    )
