"""Which logs there are, and where their recordings go: never two to one place, never outside the
output folder.
"""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spoofbench.conversion import Source
from spoofbench.conversion.planning import plan
from spoofbench.errors import ConversionError


@pytest.fixture
def converters(install: Any) -> None:
    install(
        "whole",
        [],
        sniff=lambda source: float(not source.path.is_dir() or "whole" in source.members()),
    )


def touch(folder: Path, *names: str) -> list[Path]:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")
    return [folder / name for name in names]


def targets(inputs: list[Path], out: Path) -> list[str]:
    return [job.target.relative_to(out).as_posix() for job in plan(inputs, out)]


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a.ubx", "b.nmea.gz"], ["a.mcap", "b.mcap"]),
        (["a/x.ubx", "b/x.ubx", "y"], ["a-x.mcap", "b-x.mcap", "y.mcap"]),
        (["a/x.ubx", "a/x.nmea"], ["x.ubx.mcap", "x.nmea.mcap"]),
        (["a/x.ubx", "a/X.nmea"], ["x.ubx.mcap", "X.nmea.mcap"]),
        (["a/x.ubx", "b/x.ubx", "a-x"], ["x.ubx.mcap", "b-x.mcap", "a-x.mcap"]),
        (["a/x.ubx", "a/x.ubx"], ["x.mcap"]),
    ],
)
def test_names_are_short_and_distinct(
    names: list[str], expected: list[str], converters: None, tmp_path: Path
) -> None:
    (tmp_path / "out").mkdir()
    assert targets(touch(tmp_path, *names), tmp_path / "out") == expected


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.sampled_from(["x", "X", "x-2", "a-x", "x.ubx", "a-x.ubx", "x.ubx.gz", "..x", "x-2.ubx"]),
        min_size=2,
        unique=True,
    ),
    st.data(),
)
def test_no_two_logs_share_a_name(
    install: Any, tmp_path: Path, names: list[str], data: Any
) -> None:
    install("none", [], sniff=0.0)
    folders = data.draw(
        st.lists(st.sampled_from(["a", "b/a", "b", "."]), min_size=len(names), max_size=len(names))
    )
    paths = touch(
        tmp_path, *(f"{folder}/{name}" for folder, name in zip(folders, names, strict=True))
    )
    made = [job.target for job in plan(paths, tmp_path / "out")]
    assert len({str(target).casefold() for target in made}) == len(paths)
    assert all(target.parent == tmp_path / "out" for target in made)


def test_one_log_goes_to_the_file_that_is_named(converters: None, tmp_path: Path) -> None:
    (log,) = touch(tmp_path, "a.ubx")
    assert [job.target for job in plan([log], tmp_path / "out.mcap")] == [tmp_path / "out.mcap"]


def test_a_folder_is_one_log_or_walked(converters: None, tmp_path: Path) -> None:
    touch(
        tmp_path,
        "logs/a.ubx",
        "logs/sub/a.ubx",
        "logs/sub/b.ubx",
        "logs/bag/whole",
        "logs/bag/part",
        "logs/.hidden",
        "logs/out/old.mcap",
    )
    out = tmp_path / "logs" / "out"
    jobs = plan([tmp_path / "logs"], out)
    assert [job.target.relative_to(out).as_posix() for job in jobs] == [
        "a.mcap",
        "bag.mcap",
        "sub/a.mcap",
        "sub/b.mcap",
    ]
    assert all(job.walked for job in jobs)
    assert [job.source for job in plan([tmp_path / "logs" / "bag"], tmp_path / "x.mcap")] == [
        tmp_path / "logs" / "bag"
    ]


def test_names_stay_within_the_output_folder(
    converters: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    touch(tmp_path, "logs/whole", "a.ubx")
    monkeypatch.chdir(tmp_path / "logs")
    (tmp_path / "out").mkdir()
    for inputs in ([Path()], [Path("../logs/../logs")], [Path("..") / "a.ubx"]):
        (job,) = plan(inputs, tmp_path / "out")
        assert job.target.resolve().parent == tmp_path / "out"
        assert Source.of(job.source)


def test_what_is_not_there_is_an_error(converters: None, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConversionError, match="does not exist"):
        plan([tmp_path / "missing"], tmp_path / "out")
    with pytest.raises(ConversionError, match="there is no file in"):
        plan([tmp_path / "empty"], tmp_path / "out")
