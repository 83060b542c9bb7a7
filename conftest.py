"""What the tests of the core and of the plugins share."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

from spoofbench.conversion import convert
from spoofbench.demo import drive_bag
from spoofbench.errors import SpoofbenchError

# A loaded machine is no failure. Where CI is set, hypothesis's own profile also draws the same
# examples every time.
settings.register_profile("patient", settings.get_profile("default"), deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "patient")


@pytest.fixture(scope="session")
def converted_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of the 43-minute drive, converted once for all tests of a run."""
    try:
        bag = drive_bag()
    except SpoofbenchError as error:
        pytest.skip(str(error))
    recording = tmp_path_factory.mktemp("drive") / "drive.mcap"
    convert(bag, recording)
    return recording
