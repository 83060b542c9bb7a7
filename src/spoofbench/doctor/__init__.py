"""The doctor: what is wrong, or to be known, about a recording before anything is judged by it.

Every check is a pure function from a recording to findings, and says nothing where it cannot judge.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType

import numpy as np

from spoofbench.codec import read
from spoofbench.conversion import Source, convert, detect_format
from spoofbench.doctor import (
    clocks,
    contents,
    gyro_consistency,
    inertial,
    motion,
    positions,
)
from spoofbench.doctor.findings import SEVERITIES, Check, Finding, Severity, as_rows, as_text
from spoofbench.errors import ConversionError
from spoofbench.recording import Recording
from spoofbench.schema import split_topic

__all__ = [
    "CHECKS",
    "SEVERITIES",
    "Check",
    "Finding",
    "Severity",
    "as_rows",
    "as_text",
    "examine",
    "examine_file",
]

_MAGIC = b"\x89MCAP0\r\n"

CHECKS: Sequence[Check] = (
    contents.kinds,
    contents.fused,
    contents.losses,
    contents.zeros,
    contents.labels,
    clocks.rollovers,
    clocks.default_dates,
    clocks.leap_seconds,
    clocks.time_zones,
    clocks.clock_steps,
    clocks.drifts,
    clocks.clock_offsets,
    clocks.early_receipt,
    contents.gaps,
    contents.rate_changes,
    contents.repeated_epochs,
    contents.slow_imu,
    positions.impossible,
    positions.held,
    positions.jumping,
    positions.heights,
    positions.height_surfaces,
    motion.speeds,
    motion.velocity_frames,
    motion.courses,
    inertial.gravity,
    inertial.ranges,
    inertial.frozen,
    inertial.magnetic_fields,
    gyro_consistency.turns,
    positions.receiver_lags,
    positions.receiver_heights,
)


def examine(recording: Recording) -> list[Finding]:
    """Return all findings, the worst first."""
    with np.errstate(all="ignore"):  # values beyond measure are what is looked for
        findings = [finding for check in CHECKS for finding in check(recording)]
    return sorted(findings, key=lambda finding: -SEVERITIES.index(finding.severity))


def examine_file(
    path: Path, log_format: str | None = None, options: Mapping[str, str] = MappingProxyType({})
) -> list[Finding]:
    """Return the findings on a recording, or on a raw log, which is converted for it.

    Args:
        path: of a recording, or a raw log: a file, folder or archive.
        log_format: converter of a raw log; else found by content.
        options: its options, as texts.

    Raises:
        FormatError: the recording is damaged; ConversionError: the log cannot be converted.
    """
    if log_format is None and _is_recording(path):
        return examine(read(path))
    with TemporaryDirectory(prefix="spoofbench-") as folder:
        converted = Path(folder) / "log.mcap"
        convert(path, converted, format=log_format, options=options)
        recording = read(converted)
        origin = {**recording.metadata["origin"], clocks.MODIFIED: str(path.stat().st_mtime_ns)}
        return examine(recording.with_metadata({"origin": origin}))


def _is_recording(path: Path) -> bool:
    """Whether a file is MCAP with rows of ours in it, or at least no log that a converter knows,
    such as a bag in MCAP.
    """
    if not path.is_file():
        return False
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            return False
    if any(split_topic(topic)[0] for topic in read(path)):
        return True
    try:
        detect_format(Source.of(path))
    except ConversionError:
        return True
    return False
