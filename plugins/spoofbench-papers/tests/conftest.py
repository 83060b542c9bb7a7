"""The short form of each reproduction, made once for all tests of a run."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from spoofbench_papers.reproduction import Reproduced, reproduce_paper

ShortForm = Callable[[str], tuple[Path, Reproduced]]


@pytest.fixture(scope="session")
def short_form(tmp_path_factory: pytest.TempPathFactory) -> ShortForm:
    """A function from a paper's name to the folder with its pages, and what was found."""

    @cache
    def make(paper: str) -> tuple[Path, Reproduced]:
        shares: list[float] = []
        page, found = reproduce_paper(
            paper, tmp_path_factory.mktemp(paper), None, True, shares.append
        )
        assert shares == sorted(shares)
        assert 0 <= shares[0] <= shares[-1] == 1
        return page.parent, found

    return make
