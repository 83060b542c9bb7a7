"""Imports run one way: a module may import only what stands before it in this list."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent / "src"
ORDER = [
    "errors",
    "arrays",
    "config",
    "gnss_time",
    "formatting",
    "integrity",
    "schema",
    "table",
    "recording",
    "navigation",
    "codec",
    "plugins",
    "sandbox",
    "conversion",
    "attacks",
    "detector",
    "results",
    "scoring",
    "suite",
    "runner",
    "report",
    "reproducing",
    "assessing",
    "api",
    "doctor",
    "export",
    "info",
    "testing",
    "demo",
    "terminal",
    "cli",
]


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
                if node.module == "spoofbench"
            )


def _upward(path: Path) -> list[str]:
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    height = ORDER.index(_floor(module)) if _floor(module) not in ("", "__init__") else -1
    return [
        f"{path.relative_to(ROOT)}:{line} imports {target}"
        for line, target in _imports(path)
        if target.startswith("spoofbench.")
        and _floor(target) in ORDER
        and ORDER.index(_floor(target)) > height
    ]


def test_every_module_has_a_floor() -> None:
    assert {
        _floor(".".join(p.relative_to(ROOT).with_suffix("").parts)) for p in ROOT.rglob("*.py")
    } <= {*ORDER, "__init__", "__main__"}


def test_imports_run_downwards() -> None:
    upward = [
        line
        for path in sorted(ROOT.rglob("*.py"))
        if path.name != "__main__.py"
        for line in _upward(path)
    ]
    assert upward == []


def test_core_imports_no_converter_or_plugin() -> None:
    names = {target.split(".")[0] for path in ROOT.rglob("*.py") for _, target in _imports(path)}
    plugins = {path.parent.name for path in (ROOT.parent / "plugins").glob("*/src/*/__init__.py")}
    assert not names & {"spoofbench_converters", *plugins}


def test_an_upward_import_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    path = tmp_path / "spoofbench" / "recording.py"
    path.parent.mkdir()
    path.write_text("def f():\n    from spoofbench import runner\n")
    assert _upward(path) == ["spoofbench/recording.py:2 imports spoofbench.runner"]
