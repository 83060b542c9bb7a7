"""The committed pages of the reproductions are those that the code makes: its short form gives
cells that stand in them.
"""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from spoofbench_papers.reproduction import Cell, Reproduced, as_markdown, tally

PAGES = Path(__file__).parents[3] / "benchmarks" / "reproductions"


@pytest.mark.slow
@pytest.mark.parametrize("paper", ["tanil2018", "kujur", "lo2017", "borio"])
def test_short_form(paper: str, short_form: Callable[[str], tuple[Path, Reproduced]]) -> None:
    folder, found = short_form(paper)
    committed = {
        (cell["item"], cell["printed"])
        for cell in json.loads((PAGES / paper / "verdicts.json").read_text())
    }
    made = {(cell.item, cell.printed) for cell in found.cells}
    assert made <= committed
    assert len(made) == len(found.cells)
    text = (PAGES / paper / "README.md").read_text()
    assert all(f"**{item}**".replace("|", "\\|") in text for item, _ in made)
    assert (folder / "index.html").read_text().count("<tr>") == len(found.cells) + 1
    for picture in found.pictures:
        assert (PAGES / paper / f"{picture.name}.png").stat().st_size > 2000


def test_text_of_cells() -> None:
    class Paper:
        TITLE, PAPER = "A title", "Somebody"

        def reproduce(self, *_: object) -> Reproduced:
            raise NotImplementedError

    cells = [
        Cell("a | b", 1.23456, None, None, None, "not reproduced", "because"),
        Cell("c", "trend", 2.0, 1.0, 3.0, "matches", "so"),
    ]
    text = as_markdown(Paper(), Reproduced(cells, [], ["note"]))
    assert "| 1.235 | - | - | not reproduced | **a \\| b**: because |" in text
    assert "| trend | 2 | 1 to 3 | matches | **c**: so |" in text
    assert text.endswith("- note\n")
    assert tally(cells) == {
        "matches": 1,
        "matches after calibration": 0,
        "trend only": 0,
        "not reproduced": 1,
    }
