"""Layouts, names and lengths agree with pyubx2's payload tables."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from pyubx2 import UBX_MSGIDS
from pyubx2.ubxtypes_get import UBX_PAYLOADS_GET
from spoofbench_converters.ubx.messages import (
    MESSAGES,
    MON_HW_6,
    NUMBER,
    NUMBER_OF_KEY,
    SEC_SIG,
    Message,
    layout,
    offset_in,
)
from spoofbench_converters.ubx.names import key_of, name_of

_ALIASES = {  # what the reference calls some fields, or does not describe
    "sec": {"second"},
    "valid": {"validflags"},
    "flags": {"sigsecflags"},
    "data": {"datafield"},
    "sTtag": {"stag"},
    "msss": {"reserved1"},
    "version": {"reserved1"},
}


def _walk(table: dict[str, Any]) -> Iterator[tuple[str, str, int, bool]]:
    """Yield name, kind, offset and whether it is in the block, of each field of a pyubx2 table."""
    at = 0
    for name, told in table.items():
        if isinstance(told, tuple) and isinstance(told[1], dict):
            if name.endswith("_bit"):
                yield name.removesuffix("_bit"), "X", at, False
                at += int(told[0][1:])
                continue
            if isinstance(told[0], int):  # a group of constant length
                yield next(iter(told[1])), "V", at, False
                at += told[0] * sum(int(kind[1:]) for kind in told[1].values())
                continue
            yield from ((inner, kind, offset, True) for inner, kind, offset, _ in _walk(told[1]))
            continue
        kind = told[0] if isinstance(told, tuple) else told
        yield name, kind[0], at, False
        at += int(kind[1:])


def _reference(message: Message) -> dict[tuple[int, bool], tuple[str, str]]:
    name = "SEC-SIG-V2" if message.name == "SEC-SIG" else message.name
    return {
        (offset, block): (field, kind)
        for field, kind, offset, block in _walk(UBX_PAYLOADS_GET[name])
    }


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)
def test_fields_stand_where_they_should(message: Message) -> None:
    reference = _reference(message)
    for structure, is_block in ((message.head, False), (message.block, True)):
        for name in (structure.names or ()) if structure is not None else ():
            field, kind = reference[offset_in(structure, name), is_block]
            told = (
                field.lower().strip("_").replace("hp", "", 1)
                if name.endswith("Hp")
                else field.lower()
            )
            assert told in {name.lower().removesuffix("hp"), *_ALIASES.get(name, ())}, (name, field)
            mine = structure[name].kind
            assert (mine == "i") == (kind == "I"), name
            assert (mine == "f") == (kind == "R"), name


def test_heads_and_blocks_are_as_long_as_they_should_be() -> None:
    lengths = {
        "NAV-PVT": 92,
        "NAV-PVAT": 116,
        "NAV-SOL": 52,
        "NAV-COV": 64,
        "MON-HW": 60,
        "TIM-TM2": 28,
        "ESF-INS": 36,
        "HNR-PVT": 72,
    }
    lengths |= {
        "RXM-MEASX": 44,
        "RXM-RAWX": 16,
        "ESF-STATUS": 16,
        "MON-VER": 40,
        "SEC-SIG": 4,
        "NAV-HPPOSLLH": 36,
        "RXM-SFRB": 42,
    }
    for name, length in lengths.items():
        assert MESSAGES[NUMBER[name]].head.itemsize == length, name
    blocks = {
        "NAV-SAT": 12,
        "NAV-SVINFO": 12,
        "NAV-SIG": 16,
        "RXM-RAW": 24,
        "RXM-RAWX": 32,
        "RXM-MEASX": 24,
        "MON-RF": 24,
    }
    for name, length in blocks.items():
        block = MESSAGES[NUMBER[name]].block
        assert block is not None
        assert block.itemsize == length, name


def test_versions_of_one_message_share_offsets() -> None:
    assert MON_HW_6.itemsize == 68
    assert offset_in(MON_HW_6, "jamInd") == 53  # u-blox 6 has 25 virtual pins where u-blox 8 has 17
    assert SEC_SIG.itemsize == 12
    first = {field: offset for field, _, offset, _ in _walk(UBX_PAYLOADS_GET["SEC-SIG-V1"])}
    assert (offset_in(SEC_SIG, "jam"), offset_in(SEC_SIG, "spoof")) == (
        first["jamFlags"],
        first["spfFlags"],
    )


def test_names_are_those_of_the_reference() -> None:
    for octets, name in UBX_MSGIDS.items():
        if len(octets) == 2 and octets[0] < 0x66:
            assert name_of(int.from_bytes(octets, "big")) == name
    assert name_of(0x01FF) == "01-FF"


def test_every_message_is_found_by_its_number() -> None:
    for message in MESSAGES:
        assert MESSAGES[NUMBER_OF_KEY[key_of(message.name)]] is message


def test_a_layout_skips_bytes() -> None:
    structure = layout("a:u1 _:2 b:i2")
    assert structure.itemsize == 5
    assert np.frombuffer(bytes([7, 1, 1, 254, 255]), structure)[0].tolist() == (7, -2)
