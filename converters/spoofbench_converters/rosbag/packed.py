"""Messages that were packed one by one, as ROS 2 does on request."""

import numpy as np

from spoofbench_converters.rosbag.slabs import MAX_MESSAGE_BYTES, Payloads, Slab, rejects

_MAGIC = b"\x28\xb5\x2f\xfd"
_DAMAGED = "the packed message cannot be unpacked to the size that a message has"


def unpacked_messages(slab: Slab) -> Slab:
    """Return a slab with the messages unpacked of topics that are packed by zstd; those that cannot
    be are rejects.
    """
    packed = [number for number, payloads in slab.wanted.items() if _is_packed(payloads)]
    if not packed:
        return slab
    wanted, refused = dict(slab.wanted), list(slab.rejects)
    for number in packed:
        payloads = slab.wanted[number]
        unpacked, good = _unpacked(payloads)
        wanted[number] = unpacked
        if not good.all():
            refused.append(rejects(payloads.records[~good], _DAMAGED))
    return Slab(
        {number: payloads for number, payloads in wanted.items() if payloads.records.size},
        slab.others,
        refused,
    )


def _is_packed(payloads: Payloads) -> bool:
    """Whether the first message starts as zstd does, and as none in CDR does."""
    start = int(payloads.starts[0])
    return payloads.octets[start : start + 4].tobytes() == _MAGIC


def _unpacked(payloads: Payloads) -> tuple[Payloads, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    import zstandard

    unpacker, joined, lengths = zstandard.ZstdDecompressor(), bytearray(), []
    octets = payloads.octets.data
    for start, length in zip(payloads.starts.tolist(), payloads.lengths.tolist(), strict=True):
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
    return Payloads(
        np.frombuffer(bytes(joined), np.uint8),
        places,
        sizes,
        payloads.records[good],
        payloads.stamps_ns[good],
    ), good
