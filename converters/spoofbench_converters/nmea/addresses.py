"""Addresses of sentences: talker and type, and what is said of those that are not read."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spoofbench_converters.nmea.fields import Ints, Sentences

READ = (
    "GGA", "RMC", "GLL", "GNS", "ZDA", "GST", "GBS", "GRS", "VTG", "GSA", "GSV", "DTM", "HDT",
    "THS",
    "PUBX00", "PUBX03", "PUBX04", "PGRME", "PASHR", "VNYMR", "VNIMU", "GYOACC", "IMURAW",
)  # fmt: skip
CODES = {name: code for code, name in enumerate(READ)}
GNSS_TALKERS = frozenset(("GP", "GN", "GL", "GA", "GB", "BD", "GQ", "QZ", "GI", "IM", "PQ"))

_WHOLE = frozenset(("PGRME", "PASHR", "VNYMR", "VNIMU", "GYOACC", "IMURAW"))
_QUALCOMM = {
    "PQGSV": "GSV",
    "PQGSA": "GSA",
}  # of BeiDou and QZSS, as the system id at their end says
_STANDARD = frozenset(name for name in READ if len(name) == 3)
_KEY_BYTES = 8
_MAX_REASONS = 64
_MAX_KNOWN = 65_536


@dataclass(frozen=True, slots=True)
class Address:
    """What an address means: ``code`` of the type, -1 where it is not read, for the ``reason``; and
    the ``talker``.
    """

    code: int
    talker: str
    reason: str


def address_of(text: str) -> Address:
    """Return what an address, cut to eight characters, means."""
    if text in _QUALCOMM:
        return Address(CODES[_QUALCOMM[text]], "PQ", "")
    if text in _WHOLE:
        return Address(CODES[text], text[:2], "")
    if text == "PUBX":
        return Address(CODES["PUBX00"], "PUBX", "")
    if text.startswith("P") and len(text) >= 4:
        return Address(-1, "", f"NMEA {text[:4]}: vendor's own sentence, not read")
    kind = text[2:]
    if len(text) != 5 or not text.isascii() or not text.isalnum() or not text.isupper():
        return Address(-1, "", "NMEA: no sentence of the standard")
    if kind in _STANDARD:
        return Address(CODES[kind], text[:2], "")
    return Address(-1, "", f"NMEA {kind}: nothing in the schema")


class Addresses:
    """The addresses that a log has shown so far."""

    def __init__(self) -> None:
        self.talkers: list[str] = []
        self.reasons: list[str] = []
        self._keys = np.empty(0, np.uint64)
        self._meanings = np.empty((0, 3), np.int64)

    def read(self, sentences: Sentences) -> tuple[Ints, Ints, Ints]:
        """Return for each sentence the code of its type, the place of its talker and that of its
        reason, -1 for none.
        """
        keys = _keys(sentences)
        place = np.minimum(np.searchsorted(self._keys, keys), max(self._keys.size - 1, 0))
        unknown = (
            np.flatnonzero(self._keys[place] != keys) if self._keys.size else np.arange(keys.size)
        )
        if unknown.size:
            new, first = np.unique(keys[unknown], return_index=True)
            self._learn(new[np.argsort(first)].tolist())
            place = np.searchsorted(self._keys, keys)
        code, talker, reason = self._meanings[place].T
        return self._with_numbers(sentences, code, reason.copy(), talker)

    def reason(self, text: str) -> int:
        """Return the place of a reason; the 65th and later ones share one."""
        if text not in self.reasons:
            if len(self.reasons) > _MAX_REASONS:
                return _MAX_REASONS
            self.reasons.append(
                "NMEA: sentences of further types, not read"
                if len(self.reasons) == _MAX_REASONS
                else text
            )
        return self.reasons.index(text) if text in self.reasons else _MAX_REASONS

    def _with_numbers(
        self, sentences: Sentences, code: Ints, reason: Ints, talker: Ints
    ) -> tuple[Ints, Ints, Ints]:
        """Tell apart the sentences that u-blox numbers by their first field."""
        rows = np.flatnonzero(code == CODES["PUBX00"])
        if rows.size:
            number = sentences.of(rows).cells(1)
            code = code.copy()
            code[rows] = -1
            for digit in "034":
                named = (
                    (number.length == 2) & (number.at(0) == ord("0")) & (number.at(1) == ord(digit))
                )
                code[rows[named]] = CODES[f"PUBX0{digit}"]
            reason[rows] = self.reason("NMEA PUBX: vendor's own sentence, not read")
        return code, talker, reason

    def _learn(self, new: list[int]) -> None:
        """Take keys not seen before, in the order of appearance; of too many those that are not
        read are forgotten.
        """
        if self._keys.size > _MAX_KNOWN:
            kept = self._meanings[:, 0] >= 0
            self._keys, self._meanings = self._keys[kept], self._meanings[kept]
        meanings = []
        for key in new:
            address = address_of(key.to_bytes(_KEY_BYTES, "big").rstrip(b"\0").decode("latin1"))
            meanings.append(
                (
                    address.code,
                    self._talker(address.talker),
                    self.reason(address.reason) if address.reason else -1,
                )
            )
        keys = np.concatenate([self._keys, np.array(new, np.uint64)])
        order = np.argsort(keys)
        self._keys = keys[order]
        self._meanings = np.concatenate([self._meanings, np.array(meanings, np.int64)])[order]

    def _talker(self, talker: str) -> int:
        if talker not in self.talkers:
            self.talkers.append(talker)
        return self.talkers.index(talker)


def _keys(sentences: Sentences) -> NDArray[np.uint64]:
    """The first eight characters of each address as one number."""
    cells = sentences.addresses()
    keys = np.zeros(cells.begin.size, np.uint64)
    for place in range(_KEY_BYTES):
        keys = keys << np.uint64(8) | cells.at(place).astype(np.uint64)
    return keys
