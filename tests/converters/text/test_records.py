"""Records are found as a slow reader finds them, one character after the other."""

import csv
import io

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from spoofbench_converters.text.records import MAX_RECORD_LINES, find, find_by_blanks, tabbed

Record = tuple[int, int, int, bool]
"""Start, end, number of cells, whether it is damaged."""


def _lines(text: str) -> list[tuple[int, int]]:
    starts = [0, *(place + 1 for place, each in enumerate(text) if each == "\n")]
    return [
        (start, stop)
        for start, stop in zip(starts, [*starts[1:], len(text)], strict=True)
        if stop > start
    ]


def _is_at_cell(text: str, place: int) -> bool:
    return place == 0 or text[place - 1] in ",\n\r"


def _slow(text: str) -> list[Record]:
    """RFC 4180; a line that does not open a cell with a mark has none, and one whose marks do not
    fit is damaged alone.
    """
    lines = _lines(text)
    found: list[Record] = []
    line = 0
    while line < len(lines):
        start, stop = lines[line]
        marks = [place for place in range(start, stop) if text[place] == '"']
        if not any(_is_at_cell(text, place) for place in marks):
            found.append((start, stop, text[start:stop].count(",") + 1, False))
            line += 1
            continue
        inside, sound, cells, after, place = False, True, 1, line, start
        while True:
            end = lines[after][1]
            while place < end and sound:
                if text[place] == '"':
                    following = text[place + 1] if place + 1 < len(text) else "\n"
                    sound = (
                        following in ',\n\r"'
                        if inside
                        else _is_at_cell(text, place) or text[place - 1] == '"'
                    )
                    inside = not inside
                elif text[place] == "," and not inside:
                    cells += 1
                place += 1
            after += 1
            if not sound or not inside:
                break
            if after == len(lines) or after - line >= MAX_RECORD_LINES:
                sound = False
                break
        if sound:
            found.append((start, lines[after - 1][1], cells, False))
            line = after
        else:
            found.append((start, stop, text[start:stop].count(",") + 1, True))
            line += 1
    return found


def _quick(text: str) -> list[Record]:
    found = find(np.frombuffer(text.encode(), np.uint8), ord(","), ord("\n"), b"", True)
    ends = found.starts + found.lengths()
    return list(
        zip(
            found.starts.tolist(),
            ends.tolist(),
            found.cells.tolist(),
            found.damaged.tolist(),
            strict=True,
        )
    )


@settings(max_examples=400, deadline=None)
@given(
    st.text(st.sampled_from('a,"\n'), max_size=60)
    | st.text(st.sampled_from('aaa,,""\n\r'), max_size=400)
)
def test_any_marks(text: str) -> None:
    assert _quick(text) == _slow(text)


def test_a_cell_without_end() -> None:
    for lines in (MAX_RECORD_LINES - 1, MAX_RECORD_LINES, MAX_RECORD_LINES + 1):
        text = 'x,"' + "a\n" * lines + '"\n1,2\n'
        assert _quick(text) == _slow(text)


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.lists(
            st.text(
                st.characters(blacklist_categories=["Cs"], blacklist_characters="\r\0"), max_size=5
            ),
            min_size=2,
            max_size=4,
        )
    )
)
def test_what_the_standard_writer_writes(rows: list[list[str]]) -> None:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    octets = np.frombuffer(out.getvalue().encode(), np.uint8)
    found = find(octets, ord(","), ord("\n"), b"", True)
    assert found.cells.tolist() == [len(row) for row in rows]
    assert not found.damaged.any()


@settings(max_examples=100, deadline=None)
@given(st.text(st.sampled_from("ab \t\n\r"), max_size=80))
def test_words_between_blanks(text: str) -> None:
    octets = np.frombuffer(text.encode(), np.uint8)
    found = find_by_blanks(octets, ord("\n"), True)
    lines = [text[start:stop] for start, stop in _lines(text)]
    assert found.cells.tolist() == [len(line.split()) for line in lines]
    assert [line.split() for line in tabbed(octets).tobytes().decode().split("\n")] == [
        line.split() for line in text.split("\n")
    ]
    assert " " not in tabbed(octets).tobytes().decode()
