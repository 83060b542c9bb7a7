"""What is fuzzed, and what must hold of every input."""

from collections import Counter
from contextlib import suppress
from pathlib import Path

from benchmarks.fuzz.reference import frames
from spoofbench import plugins
from spoofbench.codec import read, validate
from spoofbench.conversion import Source
from spoofbench.errors import SpoofbenchError
from spoofbench.testing.converter_cases import (
    ConverterOutcome,
    ConverterUnderTest,
    TrickledSource,
    differing,
)

MCAP = "mcap"
_TRICKLE_EVERY = 8
_PIECES = (4 * 2**20, 4096, 65_536)


class Broken(AssertionError):
    """An input for which a law does not hold; the text says which."""


def names() -> list[str]:
    """Return the names of all targets: the converters, and the reader of recordings."""
    return [*sorted(plugins.found(plugins.CONVERTERS)), MCAP]


def check(target: str, path: Path, turn: int) -> None:
    """Give an input to a target.

    Args:
        turn: number of the input; every eighth is also read in small pieces.

    Raises:
        Exception: whatever is not allowed: a law does not hold, or the target raises what is no
            SpoofbenchError.
    """
    if target == MCAP:
        _check_mcap(path)
        return
    subject = ConverterUnderTest(target, (path,), {}, True)
    subject.sniff(path)
    archive = path.read_bytes()[:2] == b"PK"
    whole = subject.convert(path)
    _ = whole.tables
    _check_account(subject, whole)
    if turn % _TRICKLE_EVERY == 0 and not archive:
        other = differing(subject.convert(path, TrickledSource).digests, whole.digests)
        if other:
            raise Broken(f"{other} differ in smaller pieces")
    if target in ("nmea", "ubx"):
        _check_frames(path, _PIECES[turn % len(_PIECES)])


def _check_mcap(path: Path) -> None:
    with suppress(SpoofbenchError):
        validate(path)
    with suppress(SpoofbenchError):
        recording = read(path)
        for topic in recording:
            with suppress(SpoofbenchError):
                _ = recording[topic]


def _check_account(subject: ConverterUnderTest, found: ConverterOutcome) -> None:
    if found.error is not None:
        return
    if (
        subject.converter.UNIT == "bytes"
        and found.size is not None
        and found.used + found.skipped != found.size
    ):
        raise Broken(
            f"used and skipped make {found.used + found.skipped}, not the {found.size} bytes of "
            "the log"
        )
    end = 0
    for offset, length, reason in found.rejects:
        if (
            offset < 0
            or length < 0
            or (
                found.size is not None
                and subject.converter.UNIT == "bytes"
                and offset + length > found.size
            )
        ):
            raise Broken(f"the reject {reason!r} lies beyond the log")
        if subject.converter.UNIT == "bytes" and length and offset < end:
            raise Broken(f"the reject {reason!r} overlaps another")
        end = max(end, offset + length)


def _check_frames(path: Path, piece_bytes: int) -> None:
    """The demultiplexer's frames are those of the slow reference."""
    from benchmarks.agreement.ours import frames_found

    with suppress(SpoofbenchError), Source.of(path).open() as stream:
        log = stream.read()
        expected = Counter(
            log[frame.start : frame.start + frame.length]
            for frame in frames(log)
            if frame.protocol != "rtcm3"
        )
        found = frames_found(path, piece_bytes)
        if found != expected:
            lost, more = expected - found, found - expected
            raise Broken(
                f"frames differ from the reference: lost {list(lost)[:2]!r}, more "
                f"{list(more)[:2]!r}"
            )
