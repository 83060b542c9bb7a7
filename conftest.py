"""What the tests of the core and of the plugins share."""

from pathlib import Path

import pytest

from spoofbench.converting import convert
from spoofbench.demo import drive_bag
from spoofbench.errors import SpoofbenchError


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
