"""One name means one thing, arrays have shapes, and modules do not import each other in circles."""

from pathlib import Path

from benchmarks.structure.__main__ import circles, class_names, imports, shapeless

ROOT = Path(__file__).parent.parent


def test_a_class_name_is_defined_once() -> None:
    assert class_names(ROOT) == {}


def test_public_functions_of_arrays_say_the_shape() -> None:
    assert shapeless(ROOT) == []


def test_no_module_imports_itself_through_others() -> None:
    assert circles(imports(ROOT)) == []


def test_what_is_wrong_is_seen(tmp_path: Path) -> None:
    package = tmp_path / "src" / "spoofbench"
    package.mkdir(parents=True)
    (package / "one.py").write_text("from spoofbench.two import B\nclass A: ...\n")
    (package / "two.py").write_text("from spoofbench import one\nclass A: ...\nclass B: ...\n")
    (package / "three.py").write_text("def half(values: NDArray) -> NDArray:\n    ...\n")
    assert class_names(tmp_path) == {"A": ["src/spoofbench/one.py", "src/spoofbench/two.py"]}
    assert circles(imports(tmp_path)) == [["spoofbench.one", "spoofbench.two"]]
    assert shapeless(tmp_path) == ["src/spoofbench/three.py:1 half"]
