"""A shelf of recipes, a server on loopback that offers their files, and a cache of its own."""

import hashlib
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from spoofbench.fetch import cache, recipe_file

HEADER = (
    "time,speed,bearing,altitude,longitude,latitude,acc_z,acc_y,acc_x,gyro_z,gyro_y,gyro_x,"
    "horizontalAccuracy,verticalAccuracy,speedAccuracy"
)
ROW = "2024-05-01 10:00:{:02d}+00:00,3.0,90.0,12.0,8.0,47.0,9.8,0.0,0.0,0.0,0.0,0.0,5.0,8.0,0.5"
LOG = "\n".join([HEADER, *(ROW.format(second) for second in range(60)), ""]).encode()


@dataclass
class Offers:
    """What the server gives for a path: bytes, an answer without any, or less than it promises."""

    files: dict[str, bytes] = field(default_factory=dict)
    cut_off: set[str] = field(default_factory=set)
    asked: list[str] = field(default_factory=list)
    address: str = ""

    def url(self, name: str) -> str:
        return f"{self.address}/{name}"


@pytest.fixture
def server() -> Iterator[Offers]:
    offers = Offers()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            name = self.path.lstrip("/")
            offers.asked.append(name)
            if name not in offers.files:
                self.send_error(404)
                return
            content = offers.files[name]
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content[: len(content) // 2] if name in offers.cut_off else content)

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as running:
        offers.address = f"http://127.0.0.1:{running.server_port}"
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield offers
        running.shutdown()
        thread.join()


@dataclass
class Shelf:
    """The folder of recipes, suites and labels, in place of the one that is shipped."""

    folder: Path

    def write(self, text: str) -> None:
        (self.folder / "recordings.toml").write_text(text)
        recipe_file.recipes.cache_clear()
        recipe_file.wheels.cache_clear()

    def offer(self, file: str, *, options: str = "{ mapping = 'strapdown_phone' }") -> None:
        """Write the recipe ``commute`` of one file."""
        self.write(
            "[recordings.commute]\ntitle = 'A'\nclass = 'phone-1hz'\nlicence = 'MIT'\n"
            f"credit = 'N. N.'\nvehicle = 'car'\nfiles = [{file}]\noptions = {options}\n"
        )

    def simulate(self, seed: int) -> None:
        """Write the recipe ``simulated`` of two minutes of a drive that never existed."""
        self.write(
            "[recordings.simulated]\ntitle = 'A'\nclass = 'car'\nlicence = 'MIT'\n"
            "credit = 'N. N.'\nvehicle = 'car'\n"
            f"simulation = {{ seed = {seed}, duration_s = 120.0, lag_s = 0.2 }}\n"
        )


def said(content: bytes) -> str:
    """Return size and digest of a file as a recipe says them."""
    return f"size = {len(content)}, sha256 = '{hashlib.sha256(content).hexdigest()}'"


@pytest.fixture
def shelf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Shelf]:
    folder = tmp_path / "shelf"
    (folder / "suites").mkdir(parents=True)
    for module in (recipe_file, cache):
        monkeypatch.setattr(module, "shipped", lambda name: folder / name)
    monkeypatch.setenv("SPOOFBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("SPOOFBENCH_MIRROR", raising=False)
    yield Shelf(folder)
    recipe_file.recipes.cache_clear()
    recipe_file.wheels.cache_clear()


@pytest.fixture
def wheel(tmp_path: Path) -> Path:
    """A wheel with the log as a member."""
    path = tmp_path / "example-1.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("example/data/log.csv", LOG)
    return path
