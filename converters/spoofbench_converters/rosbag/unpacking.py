"""What is packed within a bag: chunks, and single messages."""

import bz2
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from spoofbench_converters.rosbag.batches import (
    MAX_MESSAGE_BYTES,
    MessageBatch,
    TopicMessages,
    rejects,
)

MAX_CHUNK_BYTES = 128 << 20
_PIECE_BYTES = 65_536
_ZSTD_WINDOW_BYTES = 128 << 20


def unpack(data: bytes, packing: str, size: int) -> tuple[bytes, str | None]:
    """Return what ``data`` unpack to, of at most ``size`` bytes, and what is wrong with it, if
    anything is.

    Of what is damaged or cut off, all that comes before is returned.

    Args:
        data: packed bytes.
        packing: ``none`` or empty, ``bz2``, ``lz4`` (frames) or ``zstd``.
        size: bytes that they must unpack to.
    """
    if packing in ("none", ""):
        return data[:size], None if len(
            data
        ) == size else f"it has {len(data):,} bytes where it declares {size:,}"
    if packing not in _UNPACKERS:
        return b"", f"it is packed by {packing[:16]!r}, which cannot be unpacked"
    parts, have, wrong = [], 0, None
    try:
        for part in _UNPACKERS[packing](data, size):
            parts.append(part)
            have += len(part)
    except Exception as error:  # noqa: BLE001 - each packing has errors of its own
        wrong = f"it cannot be unpacked: {str(error) or type(error).__name__}"
    unpacked = b"".join(parts)
    return unpacked, wrong or (
        None if have == size else f"it unpacks to {have:,} bytes where it declares {size:,}"
    )


def _by_bz2(data: bytes, size: int) -> Iterator[bytes]:
    return _drained(bz2.BZ2Decompressor(), data, size)


def _by_lz4(data: bytes, size: int) -> Iterator[bytes]:
    import lz4.frame

    return _drained(lz4.frame.LZ4FrameDecompressor(), data, size)


def _drained(unpacker: Any, data: bytes, size: int) -> Iterator[bytes]:
    """Yield what data unpack to, at most so much; given piece by piece, so that damage costs no
    more than its piece.
    """
    for start in range(0, len(data), _PIECE_BYTES):
        piece = data[start : start + _PIECE_BYTES]
        while (
            size > 0 and not unpacker.eof and (part := unpacker.decompress(piece, max_length=size))
        ):
            yield part
            size -= len(part)
            piece = b""
            if unpacker.needs_input:
                break


def _by_zstd(data: bytes, size: int) -> Iterator[bytes]:
    import zstandard

    unpacker = zstandard.ZstdDecompressor(max_window_size=_ZSTD_WINDOW_BYTES)
    with unpacker.stream_reader(data, read_across_frames=True) as reader:
        while size > 0 and (part := reader.read(min(size, _PIECE_BYTES))):
            yield part
            size -= len(part)


_UNPACKERS: dict[str, Callable[[bytes, int], Iterator[bytes]]] = {
    "bz2": _by_bz2,
    "lz4": _by_lz4,
    "zstd": _by_zstd,
}


_MAGIC = b"\x28\xb5\x2f\xfd"
_DAMAGED = "the packed message cannot be unpacked to the size that a message has"


def unpacked_messages(batch: MessageBatch) -> MessageBatch:
    """Return a batch whose messages packed by zstd are unpacked; those that cannot be are
    rejects.
    """
    packed = [number for number, messages in batch.wanted.items() if _is_packed(messages)]
    if not packed:
        return batch
    wanted, refused = dict(batch.wanted), list(batch.rejects)
    for number in packed:
        messages = batch.wanted[number]
        unpacked, good = _unpacked(messages)
        wanted[number] = unpacked
        if not good.all():
            refused.append(rejects(messages.records[~good], _DAMAGED))
    return MessageBatch(
        {number: messages for number, messages in wanted.items() if messages.records.size},
        batch.others,
        refused,
    )


def _is_packed(messages: TopicMessages) -> bool:
    """Whether the first message starts as zstd does, and as none in CDR does."""
    start = int(messages.starts[0])
    return messages.octets[start : start + 4].tobytes() == _MAGIC


def _unpacked(
    messages: TopicMessages,
) -> tuple[TopicMessages, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    import zstandard

    unpacker, joined, lengths = zstandard.ZstdDecompressor(), bytearray(), []
    octets = messages.octets.data
    for start, length in zip(messages.starts.tolist(), messages.lengths.tolist(), strict=True):
        packed = octets[start : start + length]
        try:
            # The declared size is allocated whatever the most may be.
            message = (
                unpacker.decompress(packed, MAX_MESSAGE_BYTES)
                if zstandard.frame_content_size(packed) <= MAX_MESSAGE_BYTES
                else None
            )
        except zstandard.ZstdError:
            message = None
        joined += message or b""
        lengths.append(len(message) if message else -1)
    sizes = np.array(lengths, np.int64)
    good = sizes >= 0
    sizes = sizes[good]
    places = np.cumsum(sizes) - sizes
    return TopicMessages(
        np.frombuffer(bytes(joined), np.uint8),
        places,
        sizes,
        messages.records[good],
        messages.stamps_ns[good],
    ), good
