"""Plugins that behave, and plugins that misbehave in every way that a benchmark has to survive."""

import ctypes
import gc
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from spoofbench.detector import Decisions
from spoofbench.errors import NotApplicable
from spoofbench.recording import Interval, Recording

PVT = "gnss/pvt"


@dataclass(frozen=True)
class Steady:
    """Scores the speed: says the same of the same rows."""

    scale: float = 0.1

    requires: ClassVar[tuple[str, ...]] = (PVT,)
    uses: ClassVar[tuple[str, ...]] = ()
    memory_s: ClassVar[float] = 0.0

    def detect(self, recording: Recording) -> Decisions:
        pvt = recording.primary(PVT)
        score = np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"]) * self.scale
        return Decisions(pvt.time_ns, score, ~np.isnan(score))


@dataclass(frozen=True)
class Slow(Steady):
    """Takes its time."""

    pause_s: float = 0.3

    def detect(self, recording: Recording) -> Decisions:
        time.sleep(self.pause_s)
        return super().detect(recording)


@dataclass(frozen=True)
class Opportunist(Steady):
    """Alerts where a kind is missing that it can do without: attacks do not model it."""

    uses: ClassVar[tuple[str, ...]] = ("gnss/signal",)

    def detect(self, recording: Recording) -> Decisions:
        pvt = recording.primary(PVT)
        return Decisions(
            pvt.time_ns,
            np.full(len(pvt), 0.0 if recording.topics("gnss/signal") else 2.0),
            np.ones(len(pvt), bool),
        )


@dataclass(frozen=True)
class Rated(Steady):
    """Wants to know the target false-alert rate."""

    rate_per_hour: float = 0.25


@dataclass(frozen=True)
class Raises(Steady):
    """Raises, with a message of several lines that names a folder of this machine."""

    def detect(self, recording: Recording) -> Decisions:
        raise RuntimeError(f"cannot open {Path(__file__).absolute()}\nfor topic '/gnss0/gnss/pvt'")


@dataclass(frozen=True)
class Sleeps(Steady):
    """Never answers, does not listen to polite signals, and has somebody wait with it."""

    def detect(self, recording: Recording) -> Decisions:
        import signal

        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while True:
            time.sleep(60)


@dataclass(frozen=True)
class Eats(Steady):
    """Asks for ever more memory."""

    def detect(self, recording: Recording) -> Decisions:
        kept = []
        while True:
            kept.append(np.ones(4 << 20))


@dataclass(frozen=True)
class Hungry(Steady):
    """Takes some memory and gives it back."""

    memory_mb: int = 100

    def detect(self, recording: Recording) -> Decisions:
        np.ones(self.memory_mb << 17).sum()
        return super().detect(recording)


@dataclass(frozen=True)
class Exits(Steady):
    """Ends its process."""

    def detect(self, recording: Recording) -> Decisions:
        os._exit(3)


@dataclass(frozen=True)
class Segfaults(Steady):
    """Reads where nothing is."""

    def detect(self, recording: Recording) -> Decisions:
        ctypes.string_at(0)
        raise AssertionError


@dataclass(frozen=True)
class Garbage(Steady):
    """Returns something else."""

    def detect(self, recording: Recording) -> Any:
        return {"alert": True}


@dataclass(frozen=True)
class Prints(Steady):
    """Talks too much."""

    baseline: ClassVar[bool] = True

    def detect(self, recording: Recording) -> Decisions:
        for _ in range(64):
            sys.stdout.write("x" * (1 << 16))
            sys.stderr.write("y" * (1 << 16))
        os.write(1, b"z" * (1 << 20))
        return super().detect(recording)


@dataclass(frozen=True)
class Scribbles(Steady):
    """Writes into whatever it finds open."""

    def detect(self, recording: Recording) -> Decisions:
        for descriptor in range(3, 64):
            try:
                os.write(descriptor, b'\x00\x00\x00\x05{"a":' * 8)
            except OSError:
                continue
        return super().detect(recording)


@dataclass(frozen=True)
class Strays(Steady):
    """Leaves a process behind and writes down its number."""

    note: str = ""

    def detect(self, recording: Recording) -> Decisions:
        started = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        with Path(self.note).open("a") as file:
            file.write(f"{started.pid}\n")
        return super().detect(recording)


@dataclass(frozen=True)
class Picky(Steady):
    """Ends its process on variants that are far from home."""

    most_lat_deg: float = 80.0

    def detect(self, recording: Recording) -> Decisions:
        if np.nanmax(recording.primary(PVT)["lat_deg"]) > self.most_lat_deg:
            os._exit(3)
        return super().detect(recording)


@dataclass(frozen=True)
class Flaky(Steady):
    """Fails as long as a file is there."""

    hindrance: str = ""

    def detect(self, recording: Recording) -> Decisions:
        if Path(self.hindrance).exists():
            raise RuntimeError("hindered")
        return super().detect(recording)


@dataclass(frozen=True)
class Demanding(Steady):
    """Requires a kind that few recordings have."""

    requires: ClassVar[tuple[str, ...]] = (PVT, "gnss/integrity")


@dataclass(frozen=True)
class Spy(Steady):
    """Looks for words in all that its process holds; they are given backwards, so that giving them
    does not put them there.
    """

    words_backwards: tuple[str, ...] = ()

    def detect(self, recording: Recording) -> Decisions:
        held = [
            repr(thing)
            for thing in (sys.argv, dict(os.environ), [*Path.cwd().iterdir()], Path.cwd())
        ]
        held += [
            item
            for thing in gc.get_objects()
            if type(thing) in (list, tuple, dict)
            for item in _texts(thing)
        ]
        held += [
            Path("/proc/self", name).read_text(errors="replace") for name in ("environ", "cmdline")
        ]
        for where, blocks in (
            ("objects", (text.encode(errors="replace") for text in held)),
            ("memory", _memory()),
        ):
            for block in blocks:
                backwards = block[::-1]
                for number, word in enumerate(self.words_backwards):
                    if word.encode() in backwards:
                        raise AssertionError(f"found word {number} in {where}")
        return super().detect(recording)


def _texts(thing: Any) -> list[str]:
    return [
        item
        for item in (thing.values() if isinstance(thing, dict) else thing)
        if isinstance(item, str)
    ]


def _memory() -> Any:
    maps = [line.split() for line in Path("/proc/self/maps").read_text().splitlines()]
    with Path("/proc/self/mem").open("rb", buffering=0) as memory:
        for area in maps:
            if area[1].startswith("rw"):
                first, last = (int(edge, 16) for edge in area[0].split("-"))
                memory.seek(first)
                yield memory.read(last - first)


@dataclass(frozen=True)
class Nudge:
    """Moves the latitude of an epoch or more."""

    shift_deg: float = 1.0

    models: ClassVar[frozenset[str]] = frozenset({PVT})
    attack_class: ClassVar[str] = "generated"
    level: ClassVar[str] = "pvt"
    strength_unit: ClassVar[str] = "deg"

    @property
    def strength(self) -> float:
        return self.shift_deg

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        topic = clean.topics(PVT)[0]
        table = clean[topic]
        lat_deg = np.where(
            window.covers(table.time_ns), table["lat_deg"] + self.shift_deg, table["lat_deg"]
        )
        return clean.replace({topic: table.replace(lat_deg=lat_deg)})


@dataclass(frozen=True)
class Stumbles(Nudge):
    """Raises."""

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        raise ValueError("stumbled")


@dataclass(frozen=True)
class KillsItself(Nudge):
    """Ends its process."""

    def apply(
        self,
        clean: Recording,
        window: Interval,
        rng: np.random.Generator,
        donors: Sequence[Recording] = (),
    ) -> Recording:
        os._exit(4)


@dataclass(frozen=True)
class Inapplicable(Nudge):
    """Cannot be made."""

    def attackable_span(self, clean: Recording, donors: Sequence[Recording] = ()) -> Interval:
        raise NotApplicable("there is nothing to replay")


@dataclass(frozen=True)
class FatalSupply(Nudge):
    """Ends its process when it is asked what it can supply."""

    def attackable_span(self, clean: Recording, donors: Sequence[Recording] = ()) -> Interval:
        os._exit(5)
