"""Where in a log the bytes of rejected epochs are said to lie."""

from collections.abc import Iterator

import numpy as np

from spoofbench.conversion import Rejects
from spoofbench_converters.serial.frames import Places


class Ground:
    """Keeps account of the rejects of a stretch of a log, so that those of whole epochs do not
    overlap them.

    An epoch is known by the offset of its first frame and the sum of its frames' bytes, between
    which frames of others may stand. Its bytes are laid on the first ground from its offset on that
    no reject has.
    """

    def __init__(self) -> None:
        self._starts: list[Places] = []
        self._ends: list[Places] = []

    def take(self, rejects: Rejects) -> Rejects:
        """Note rejects whose places are known, and return them."""
        self._starts.append(rejects.offsets)
        self._ends.append(rejects.offsets + rejects.lengths)
        return rejects

    def forget(self, before: int) -> None:
        """Forget what lies before the first epoch that is still undecided."""
        starts, ends = self._sorted()
        starts, ends = starts[ends > before], ends[ends > before]
        apart = np.ones(starts.size, bool)
        apart[1:] = starts[1:] > ends[:-1]
        self._starts, self._ends = [starts[apart]], [ends[np.append(apart[1:], True)[: ends.size]]]

    def lay(self, offsets: Places, lengths: Places, reason: str) -> Iterator[Rejects]:
        """Yield rejects for epochs in the order of their offsets, none of whose bytes overlap a
        reject known.
        """
        starts, ends = (each.tolist() for each in self._sorted())
        places, sizes, at, here = [], [], 0, 0
        for offset, length in zip(offsets.tolist(), lengths.tolist(), strict=True):
            at, left = max(at, offset), length
            while left:
                while here < len(starts) and ends[here] <= at:
                    here += 1
                if here < len(starts) and starts[here] <= at:
                    at = ends[here]
                    continue
                free = min(left, starts[here] - at) if here < len(starts) else left
                places.append(at)
                sizes.append(free)
                at, left = at + free, left - free
        if places:
            yield self.take(Rejects(np.array(places), np.array(sizes), reason))

    def _sorted(self) -> tuple[Places, Places]:
        starts = np.concatenate([np.zeros(0, np.int64), *self._starts])
        ends = np.concatenate([np.zeros(0, np.int64), *self._ends])
        order = np.argsort(starts, kind="stable")
        return starts[order], ends[order]
