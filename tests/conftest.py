from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture
def diagrams() -> Path:
    return ROOT / "diagrams"
