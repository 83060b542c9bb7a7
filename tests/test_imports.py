"""Imports run one way: a module may import only what stands before it in the list of its package;
the core no plugin, and a plugin no other, apart from the papers.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent / "src"
ORDER = [
    "errors",
    "arrays",
    "config",
    "shipped",
    "gnss_time",
    "formatting",
    "schema",
    "table",
    "recording",
    "navigation",
    "codec",
    "labels",
    "plugins",
    "fingerprint",
    "sandbox",
    "conversion",
    "attacks",
    "detector",
    "testing",
    "results",
    "decisions",
    "scoring",
    "fetch",
    "suite",
    "runner",
    "report",
    "api",
    "doctor",
    "export",
    "info",
    "demo",
    "terminal",
    "commands",
    "cli",
]


PAPERS = [
    "figures",
    "reproduction",
    "integrity",
    "assessment",
    "kujur",
    "tanil2018",
    "lo2017",
    "borio",
    "commands",
]
PLUGINS = sorted((ROOT.parent / "plugins").glob("*/src/*/__init__.py"))
FLOORS = {"spoofbench": ORDER, "spoofbench_papers": PAPERS}


def _floor(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else ""


def _imports(path: Path) -> Iterator[tuple[int, str]]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            yield node.lineno, node.module or ""
            yield from (
                (node.lineno, f"{node.module}.{alias.name}")
                for alias in node.names
                if node.module in FLOORS
            )


def _packages_imported(folder: Path) -> set[str]:
    return {target.split(".")[0] for path in folder.rglob("*.py") for _, target in _imports(path)}


def _upward(path: Path, root: Path) -> list[str]:
    parts = path.relative_to(root).with_suffix("").parts
    order, floor = FLOORS[parts[0]], _floor(".".join(parts))
    height = order.index(floor) if floor not in ("", "__init__") else -1
    return [
        f"{path.relative_to(root)}:{line} imports {target}"
        for line, target in _imports(path)
        if target.startswith(f"{parts[0]}.")
        and _floor(target) in order
        and order.index(_floor(target)) > height
    ]


def _package(name: str) -> Path:
    return next(
        folder for folder in (ROOT / name, *(p.parent for p in PLUGINS)) if folder.name == name
    )


@pytest.mark.parametrize("name", FLOORS)
def test_every_module_has_a_floor(name: str) -> None:
    folder = _package(name)
    floors = {path.relative_to(folder).with_suffix("").parts[0] for path in folder.rglob("*.py")}
    assert floors <= {*FLOORS[name], "__init__", "__main__"}


@pytest.mark.parametrize("name", FLOORS)
def test_imports_run_downwards(name: str) -> None:
    folder = _package(name)
    upward = [
        line
        for path in sorted(folder.rglob("*.py"))
        if path.name != "__main__.py"
        for line in _upward(path, folder.parent)
    ]
    assert upward == []


def test_core_imports_no_converter_or_plugin() -> None:
    plugins = {path.parent.name for path in PLUGINS}
    assert not _packages_imported(ROOT) & {"spoofbench_converters", *plugins}
    assert not _packages_imported(ROOT.parent / "converters") & plugins


def test_core_and_converters_need_nothing_of_the_papers() -> None:
    for folder in (ROOT, ROOT.parent / "converters"):
        assert not _packages_imported(folder) & {"matplotlib", "filterpy"}


@pytest.mark.parametrize("path", PLUGINS, ids=lambda path: path.parent.name)
def test_plugins_import_the_core_and_only_papers_import_plugins(path: Path) -> None:
    others = {other.parent.name for other in PLUGINS} - {path.parent.name}
    assert path.parent.name == "spoofbench_papers" or not _packages_imported(path.parent) & others


def test_an_upward_import_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "spoofbench" / "recording.py"
    path.parent.mkdir()
    path.write_text("def f():\n    from spoofbench import runner\n")
    assert _upward(path, tmp_path) == ["spoofbench/recording.py:2 imports spoofbench.runner"]
