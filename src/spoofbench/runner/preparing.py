"""A worker that reads one recording, finds windows for its attacks, makes its variants and leaves
truth and blind material.

It first sends a survey, then gets the list of the variants that are wanted, and sends one record
for each.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from spoofbench import codec, plugins
from spoofbench.attacks.contract import Attack, attackable_span, draw_window, make_variant
from spoofbench.errors import NotApplicable, RecordingError
from spoofbench.recording import Interval, Recording
from spoofbench.results import write_truth
from spoofbench.runner import confine
from spoofbench.runner.describing import frozen
from spoofbench.runner.material import Store
from spoofbench.runner.talk import Talk, one_line
from spoofbench.schema import TRUTH_TOPIC
from spoofbench.scoring.grid import build_truth

Attacks = Mapping[str, Attack]
Unfit = dict[str, tuple[str, str]]
"""Status and reason by id of attack."""


def work(talk: Talk, order: dict[str, Any], results: str, material: str, memory_mb: int) -> None:
    """Survey a recording, then make variants of it."""
    clean = _read(order["path"])
    donors = [_read(path) for path in order["donors"]]
    attacks: dict[str, Attack] = {
        entry["id"]: plugins.make(plugins.ATTACKS, entry["plugin"], frozen(entry["parameters"]))
        for entry in order["attacks"]
    }
    common, unfit = _common_supply(talk, attacks, clean, donors, order)
    windows = {
        str(seed): None if common is None else _window(order, seed, common)
        for seed in order["seeds"]
    }
    talk.send(
        status="ok",
        digest=clean.digest(),
        donors=[donor.digest() for donor in donors],
        kinds=sorted(clean.blind().kinds),
        windows=windows,
        unfit=unfit,
    )
    wanted = talk.receive()["variants"]
    confine.limit_memory(memory_mb << 20)
    maker = _Maker(clean, donors, attacks, Path(results), Store(Path(material), clean))
    for variant in wanted:
        talk.send(id=variant["id"], **maker.make(variant))


def _read(path: str) -> Recording:
    recording = codec.read(Path(path))
    if TRUTH_TOPIC in recording:
        raise RecordingError(
            f"{Path(path).name!r} is attacked already; a suite makes its attacks itself, from "
            "clean recordings"
        )
    return recording


def _window(order: Mapping[str, Any], seed: int, common: Interval) -> tuple[int, int]:
    window = draw_window(order["suite_seed"], order["recording"], seed, common, order["duration_s"])
    return window.start_ns, window.end_ns


def _common_supply(
    talk: Talk,
    attacks: Attacks,
    clean: Recording,
    donors: Sequence[Recording],
    order: Mapping[str, Any],
) -> tuple[Interval | None, Unfit]:
    """Return where windows may lie that all attacks share, and the attacks that can have none.

    An attack takes part if, with those before it in the suite, it leaves room for a window. Each is
    announced before its code runs, so that the main process knows whom to blame.
    """
    span, duration_s = clean.span, order["duration_s"]
    common = Interval(
        min(span.start_ns + round(order["warm_up_s"] * 1e9), span.end_ns), span.end_ns
    )
    if common.duration_s < duration_s:
        reason = (
            f"the recording has {common.duration_s:.1f} s after the warm-up, too few for an attack "
            f"of {duration_s:g} s"
        )
        return None, dict.fromkeys(attacks, ("skipped", reason))
    unfit: Unfit = {}
    for name, attack in attacks.items():
        talk.send(status="asking", attack=name)
        try:
            supply = attackable_span(attack, clean, donors)
        except NotApplicable as error:
            unfit[name] = ("skipped", str(error))
            continue
        except Exception as error:  # noqa: BLE001, a plugin may raise anything
            unfit[name] = ("failed", one_line(error))
            continue
        start_ns, end_ns = max(common.start_ns, supply.start_ns), min(common.end_ns, supply.end_ns)
        if end_ns - start_ns < round(duration_s * 1e9):
            room_s = max(0.0, (end_ns - start_ns) / 1e9)
            unfit[name] = (
                "skipped",
                (
                    f"it can be supplied for {room_s:.1f} s of what the attacks before it leave, "
                    f"not for {duration_s:g} s"
                ),
            )
            continue
        common = Interval(start_ns, end_ns)
    return common, unfit


class _Maker:
    """Makes the variants of one recording."""

    def __init__(
        self,
        clean: Recording,
        donors: Sequence[Recording],
        attacks: Attacks,
        results: Path,
        store: Store,
    ) -> None:
        self.clean, self.donors, self.attacks, self.results, self.store = (
            clean,
            donors,
            attacks,
            results,
            store,
        )

    def make(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Write one variant's truth and material; return its kinds, or the status and reason why
        there is none.
        """
        try:
            variant = self._falsify(wanted)
            write_truth(self.results, wanted["id"], build_truth(self.clean, variant))
        except NotApplicable as error:
            return {"status": "skipped", "reason": str(error)}
        except MemoryError:
            return {
                "status": "failed",
                "reason": (
                    "MemoryError: making the variant needs more memory than the suite's limit"
                ),
            }
        except Exception as error:  # noqa: BLE001, a plugin may raise anything
            return {"status": "failed", "reason": one_line(error)}
        self.store.put(wanted["number"], variant)
        return {"status": "ok", "kinds": sorted(variant.blind().kinds)}

    def _falsify(self, wanted: Mapping[str, Any]) -> Recording:
        if wanted["attack"] is None:
            return self.clean
        name = wanted["attack"]
        return make_variant(
            wanted["plugin"],
            self.attacks[name],
            self.clean,
            Interval(*wanted["window"]),
            wanted["seed"],
            self.donors,
        )
