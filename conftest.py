"""What the tests of the core and of the plugins share."""

import os
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

from spoofbench.conversion import convert

# A loaded machine is no failure. Where CI is set, hypothesis's own profile also draws the same
# examples every time.
settings.register_profile("patient", settings.get_profile("default"), deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "patient")


@pytest.fixture(scope="session")
def converted_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of the 43-minute drive, converted once for all tests of a run."""
    package = find_spec("pntos_cobra_datasets_ros")
    if package is None or not package.submodule_search_locations:
        pytest.skip("the drive is not installed: pip install 'spoofbench[demo]'")
    recording = tmp_path_factory.mktemp("drive") / "drive.mcap"
    convert(
        Path(package.submodule_search_locations[0]) / "cobra_gps_ins_example_data", recording
    )
    return recording
