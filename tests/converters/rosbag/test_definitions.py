"""The definitions written out here are those of the published package."""

from pathlib import Path

import pytest
from spoofbench_converters.rosbag import aspn23, definitions

FOLDER = Path(__file__).parents[4] / "shared" / "data" / "aspn23_msgs"


@pytest.mark.skipif(
    not FOLDER.is_dir(), reason="the published definitions are not beside the project"
)
def test_fields_and_types_are_those_published() -> None:
    published = definitions.read_folder(FOLDER, [aspn23.IMU])
    for name, (_, fields) in aspn23.definitions().items():
        assert list(fields) == list(published[name][1]), name
