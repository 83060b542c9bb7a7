"""Every converter, and the reader of recordings, on a few hundred damaged logs; ``benchmarks.fuzz``
does the same for hours.
"""

import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, given, settings

from benchmarks.fuzz.mutate import TOKENS, mutate
from benchmarks.fuzz.reference import frames
from benchmarks.fuzz.seeds import made, nmea_lines, ubx_log
from benchmarks.fuzz.targets import check, names

_PLACES = st.floats(0, 1, exclude_max=True)
_RANDOM_BYTES = st.binary(max_size=64)
_QUICKLY = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


@cache
def _logs(target: str) -> tuple[bytes, ...]:
    with tempfile.TemporaryDirectory() as folder:
        return tuple(made(target, Path(folder)))


@st.composite
def damaged(draw: Any, target: str) -> bytes:
    """A small log of the target's format after some edits, each at a place that is a share of its
    length.
    """
    log: bytes = draw(st.sampled_from(_logs(target)))
    tokens = st.sampled_from([*TOKENS.get(target, TOKENS["table"]), b""])
    for _ in range(draw(st.integers(0, 6))):
        start = int(draw(_PLACES) * (len(log) + 1))
        end = min(len(log), start + draw(st.sampled_from((0, 1, 2, 8, 100, 4000))))
        middle = draw(st.one_of(_RANDOM_BYTES, tokens, st.just(log[start:end] * 2)))
        log = log[:start] + middle + log[end:]
    return log


@pytest.mark.parametrize("target", names())
def test_a_damaged_log_gives_rows_or_one_error(target: str, tmp_path: Path) -> None:
    @_QUICKLY
    @given(damaged(target), st.integers(0, 23))
    def holds(log: bytes, turn: int) -> None:
        path = tmp_path / "log"
        path.write_bytes(log)
        check(target, path, turn)

    holds()


@pytest.mark.parametrize("target", names())
def test_mutations_that_keep_checksums_give_rows_or_one_error(target: str, tmp_path: Path) -> None:
    @_QUICKLY
    @given(st.randoms(use_true_random=False).map(lambda random: random.getrandbits(63)))
    def holds(seed: int) -> None:
        import numpy as np

        rng, logs = np.random.default_rng(seed), _logs(target)
        path = tmp_path / "log"
        path.write_bytes(
            mutate(rng, logs[seed % len(logs)], logs, TOKENS.get(target, TOKENS["table"]))
        )
        check(target, path, seed % 24)

    holds()


def test_the_reference_finds_what_was_written() -> None:
    lines, log = nmea_lines(5), ubx_log(3)
    found = list(frames(b"\r\n".join(lines)))
    assert [frame.length for frame in found] == [len(line) for line in lines]
    assert sum(frame.length for frame in frames(log)) == len(log)
    assert not list(frames(log[:20] + log[21:60]))
