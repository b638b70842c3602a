"""Fixtures shared by all test folders."""

from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def shared_data() -> Path:
    """Folder of measured spectra and captures beside the checkout; its absence is a loud skip."""
    if not (SHARED_DATA / "spectra" / "README.md").is_file():
        pytest.skip(f"MEASURED DATA ABSENT: {SHARED_DATA} not found; tests on real paint and captures were NOT run")
    return SHARED_DATA
