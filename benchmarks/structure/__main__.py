"""The size and shape of the code: ``python -m benchmarks.structure [--root CHECKOUT] [--walk]``.

Prints, per area, files, lines and lines per file; class names that are defined more than once;
public functions that take or give arrays and do not say their shape; circles among modules. With
``--walk`` it also counts the files and functions of the project that one UBX frame, one NMEA
sentence, one attacked variant and one run pass through, by tracing calls.
"""

import argparse
import ast
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOTS = ("src", "converters", "plugins", "benchmarks", "examples", "tests")
CONTRACT_NAMES = frozenset({"Options", "Converter"})
"""Names that a contract gives: each format has its own."""

_ARRAY = re.compile(r"NDArray|ndarray|ArrayLike|\b(Floats|Ints|Bools|Flags|Times|Columns|Array)\b")
_SHAPE = re.compile(r"\(\s*[a-z0-9_]+\s*,|\bshape\b|\bscalar")


def sources(root: Path, folders: tuple[str, ...] = ROOTS) -> Iterator[Path]:
    """Yield the Python files that people write, in the order of their names."""
    for folder in folders:
        for path in sorted((root / folder).rglob("*.py")):
            if "_pb2" not in path.name and "__pycache__" not in path.parts:
                yield path


def area(path: Path) -> str:
    """Return the part of the tree that a path, relative to the root, belongs to."""
    parts = path.parts
    if parts[0] == "src":
        return parts[2] if len(parts) > 3 else "core, one file"
    if parts[0] == "converters":
        return f"converters/{parts[2]}" if len(parts) > 3 else "converters"
    if parts[0] == "plugins":
        return f"{parts[1]}{'/tests' if 'tests' in parts else ''}"
    return parts[0]


def class_names(root: Path) -> dict[str, list[str]]:
    """Return the public class names that are defined in more than one place, without tests."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in sources(root, ("src", "converters", "plugins", "benchmarks")):
        if "tests" not in path.relative_to(root).parts:
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    found[node.name].append(path.relative_to(root).as_posix())
    return {
        name: places
        for name, places in sorted(found.items())
        if len(places) > 1 and name not in CONTRACT_NAMES
    }


def shapeless(root: Path) -> list[str]:
    """Return the public functions that take or give arrays and whose docstring, or that of their
    class or module, names no shape.
    """
    found = []
    for path in sources(root, ("src", "converters", "plugins")):
        if "tests" in path.relative_to(root).parts:
            continue
        tree = ast.parse(path.read_text())
        heading = ast.get_docstring(tree) or ""
        owners: list[ast.Module | ast.ClassDef] = [tree]
        owners += [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
        for owner in owners:
            if isinstance(owner, ast.ClassDef) and owner.name.startswith("_"):
                continue
            about = (ast.get_docstring(owner) or "") if isinstance(owner, ast.ClassDef) else ""
            for node in owner.body:
                if not isinstance(node, ast.FunctionDef) or node.name.startswith("_"):
                    continue
                notes = [a.annotation for a in (*node.args.args, *node.args.kwonlyargs)]
                hints = " ".join(ast.unparse(n) for n in (*notes, node.returns) if n is not None)
                text = (ast.get_docstring(node) or "") + about + heading
                if _ARRAY.search(hints) and not _SHAPE.search(text):
                    found.append(f"{path.relative_to(root)}:{node.lineno} {node.name}")
    return found


def imports(root: Path) -> dict[str, set[str]]:
    """Return which modules of the project each module imports when it is loaded."""
    modules = {}
    for path in sources(root, ("src", "converters", "plugins")):
        relative = path.relative_to(root)
        if "tests" not in relative.parts:
            start = 3 if relative.parts[0] == "plugins" else 1
            name = ".".join(relative.with_suffix("").parts[start:]).removesuffix(".__init__")
            modules[name] = path
    graph: dict[str, set[str]] = {}
    for name, path in modules.items():
        graph[name] = set()
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ImportFrom) and node.module:
                targets = [f"{node.module}.{alias.name}" for alias in node.names]
                graph[name] |= {t if t in modules else node.module for t in targets}
            elif isinstance(node, ast.Import):
                graph[name] |= {alias.name for alias in node.names}
        graph[name] = {target for target in graph[name] if target in modules} - {name}
    return graph


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the groups of modules that import each other (strongly connected components)."""
    import numpy as np
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    names = sorted(graph)
    number = {name: index for index, name in enumerate(names)}
    edges = np.array([(number[a], number[b]) for a in names for b in graph[a]]).reshape(-1, 2)
    matrix = csr_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (len(names),) * 2)
    _, labels = connected_components(matrix, directed=True, connection="strong")
    groups: dict[int, list[str]] = defaultdict(list)
    for name, label in zip(names, labels.tolist(), strict=True):
        groups[label].append(name)
    return [group for group in groups.values() if len(group) > 1]


_TRACE = """
import json, os, sys, threading
root, out = {root!r}, {out!r}
seen = set()
def profile(frame, event, argument):
    if event == "call":
        code = frame.f_code
        if code.co_filename.startswith(root) and "/.venv/" not in code.co_filename:
            if not code.co_name.startswith("<"):
                seen.add((code.co_filename, code.co_qualname))
import spoofbench.cli
sys.argv = {argv!r}
threading.setprofile(profile)
sys.setprofile(profile)
try:
    spoofbench.cli.main()
except SystemExit:
    pass
finally:
    sys.setprofile(None)
    json.dump(sorted(seen), open(out, "w"))
"""


def walk(root: Path, *command: str) -> tuple[int, int]:
    """Return how many files and functions of the project a command calls, in its own process."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "seen.json"
        script = _TRACE.format(root=f"{root}/", out=str(out), argv=["spoofbench", *command])
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        subprocess.run(
            [sys.executable, "-c", script], env=environment, check=True, capture_output=True
        )
        seen = json.loads(out.read_text())
    return len({path for path, _ in seen}), len(seen)


def walks(root: Path) -> Iterator[tuple[str, int, int]]:
    """Yield what passes through, and through how many files and functions."""
    from benchmarks.fuzz.seeds import nmea_lines, ubx_log

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = ubx_log(1)
        pvt = log.index(b"\xb5\x62\x01\x07")
        (folder / "one.ubx").write_bytes(log[pvt : pvt + 100])
        (folder / "one.nmea").write_bytes(nmea_lines(1)[0] + b"\r\n")
        long = folder / "long.nmea"
        long.write_bytes(b"\r\n".join(nmea_lines(300)) + b"\r\n")
        recording = folder / "long.mcap"
        for what, log_path in (("UBX frame", "one.ubx"), ("NMEA sentence", "one.nmea")):
            out = str(folder / f"{log_path}.mcap")
            yield what, *walk(root, "convert", str(folder / log_path), "-o", out)
        walk(root, "convert", str(long), "-o", str(recording))
        attack = ("-a", "drag-off", "--start", "100", "--duration", "60")
        variant = str(folder / "variant.mcap")
        yield "attacked variant", *walk(root, "attack", str(recording), *attack, "-o", variant)
        suite = folder / "one.toml"
        suite.write_text(
            'name = "one"\nseed = 1\nwindows = 1\nwarm_up_s = 60.0\nduration_s = 60.0\n'
            'target_far_per_hour = 1.0\n[[recordings]]\nid = "r"\npath = "long.mcap"\n'
            '[[attacks]]\nname = "drag-off"\n[[detectors]]\nname = "always"\n'
        )
        results = str(folder / "results")
        yield "run (main process)", *walk(root, "run", str(suite), "-o", results)


def main() -> None:
    """Print all of it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.structure")
    parser.add_argument("--root", type=Path, default=Path.cwd(), help="a checkout")
    parser.add_argument("--walk", action="store_true", help="also trace what passes through")
    parser.add_argument("--list", action="store_true", help="name every finding")
    arguments = parser.parse_args()
    root = arguments.root.resolve()
    files: Counter[str] = Counter()
    lines: Counter[str] = Counter()
    for path in sources(root):
        where = area(path.relative_to(root))
        files[where] += 1
        lines[where] += len(path.read_text().splitlines())
    print(f"{'area':<34}{'files':>7}{'lines':>8}{'lines/file':>12}")
    for where in files:
        print(f"{where:<34}{files[where]:>7}{lines[where]:>8}{lines[where] / files[where]:>12.0f}")
    print(f"{'all':<34}{files.total():>7}{lines.total():>8}")
    repeated, without = class_names(root), shapeless(root)
    print(f"\nclass names defined more than once: {len(repeated)}")
    print(f"public array functions without a shape: {len(without)}")
    print(f"circles of modules: {len(circles(imports(root)))}")
    if arguments.list:
        for name, places in repeated.items():
            print(f"  {name}: {', '.join(places)}")
        print("\n".join(f"  {where}" for where in without))
        print("\n".join(f"  circle: {', '.join(group)}" for group in circles(imports(root))))
    if arguments.walk:
        print(f"\n{'what passes through':<24}{'files':>7}{'functions':>11}")
        for what, in_files, in_functions in walks(root):
            print(f"{what:<24}{in_files:>7}{in_functions:>11}")


if __name__ == "__main__":
    main()
