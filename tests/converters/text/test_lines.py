"""Every byte of a log is in one line or reject, however the log is read."""

import io

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_converters.text import lines

from spoofbench.conversion import Reject, Rejects

logs = st.lists(
    st.sampled_from(
        [b"a,b\n", b"1,2\r\n", b"\n", b"\xef\xbb\xbf", b"x" * 70_000, b"\x00", b'"q,\n', b"end"]
    ),
    max_size=12,
).map(b"".join)


class Trickle(io.BytesIO):
    """Gives a few bytes at a time."""

    def read(self, size: int | None = -1) -> bytes:
        return super().read(min(size or 0, 4099) if size and size > 0 else size)


def read(log: bytes, stream: type[io.BytesIO] = io.BytesIO) -> list[tuple[int, int, bytes | str]]:
    """Return offset, length and text, or reason, of all that is read."""
    found: list[tuple[int, int, bytes | str]] = []
    for item in lines.read_lines(stream(log)):
        if isinstance(item, Reject):
            found.append((item.offset, item.length, item.reason))
        elif isinstance(item, Rejects):
            places = zip(item.offsets.tolist(), item.lengths.tolist(), strict=True)
            found += [(offset, length, item.reason) for offset, length in places]
        else:
            places = zip(
                item.offsets.tolist(),
                item.lengths.tolist(),
                item.starts.tolist(),
                item.ends.tolist(),
                strict=True,
            )
            found += [
                (offset, length, item.octets[start:end].tobytes())
                for offset, length, start, end in places
            ]
    return sorted(found, key=lambda line: line[0])


@pytest.mark.parametrize("piece", [2**20, 100, 7])
@settings(max_examples=60, deadline=None)
@given(log=logs)
def test_every_byte_is_in_one_line_or_reject_however_it_is_read(log: bytes, piece: int) -> None:
    expected = read(log)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lines, "PIECE_BYTES", piece)
        assert read(log, Trickle) == expected
    position = 0
    for offset, length, text in expected:
        assert offset == position
        position += length
        if isinstance(text, bytes):
            assert log[offset : offset + length].removeprefix(
                lines.BOM if offset == 0 else b""
            ).rstrip(b"\r\n") == text.rstrip(b"\r")
    assert position == len(log)
