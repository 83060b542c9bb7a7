"""One attack from file to file: what ``spoofbench attack`` does."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from spoofbench import plugins
from spoofbench.attacks.contract import attackable_span, draw_window, make_variant
from spoofbench.codec import read, write
from spoofbench.errors import NotApplicable
from spoofbench.recording import Interval, Recording
from spoofbench.schema import TRUTH_TOPIC


def attack_file(
    file: Path,
    out: Path,
    name: str,
    parameters: Mapping[str, Any],
    donors: Sequence[Path] = (),
    *,
    start_s: float | None = None,
    duration_s: float = 120.0,
    seed: int = 0,
) -> list[dict[str, Any]]:
    """Write the variant of a recording under an attack, and return its truth rows.

    Args:
        file, out: clean recording and variant.
        name, parameters: the attack's entry point and fields.
        donors: recordings that it may take signals from.
        start_s: of the window, after the recording's first row; None draws it by the seed.
        duration_s: of the window.
        seed: of the window and of whatever the attack draws.

    Returns:
        Rows of ``/truth/attack`` as dictionaries, with ``start_s`` and ``end_s`` after the first
        row added.

    Raises:
        PluginError: there is no such attack or parameter, or it breaks a law.
        NotApplicable: it cannot be made on this recording.
        FormatError: a file is no recording.
    """
    attack = plugins.make(plugins.ATTACKS, name, parameters)
    clean, given = read(file), [read(donor) for donor in donors]
    if start_s is None:
        window = draw_window(
            seed, clean.digest(), seed, attackable_span(attack, clean, given), duration_s
        )
    else:
        window = _window(clean, start_s, duration_s)
    variant = make_variant(name, attack, clean, window, seed, given)
    write(variant, out)
    first_ns = clean.span.start_ns
    return [
        {
            **row,
            "start_s": (row["start_ns"] - first_ns) / 1e9,
            "end_s": (row["end_ns"] - first_ns) / 1e9,
        }
        for row in _truth_rows(variant)
    ]


def _window(clean: Recording, start_s: float, duration_s: float) -> Interval:
    span = clean.span
    start_ns, end_ns = (
        span.start_ns + round(seconds * 1e9) for seconds in (start_s, start_s + duration_s)
    )
    if not span.start_ns <= start_ns < end_ns <= span.end_ns:
        raise NotApplicable(
            f"an attack from {start_s!r} s for {duration_s!r} s does not lie within the "
            f"recording's {span.duration_s:.1f} s"
        )
    return Interval(start_ns, end_ns)


def _truth_rows(variant: Recording) -> list[dict[str, Any]]:
    if TRUTH_TOPIC not in variant:
        return []
    table = variant[TRUTH_TOPIC]
    columns = {
        name: table[name].tolist() if table.column(name).words is None else table.words(name)
        for name in table
    }
    return [{name: values[row] for name, values in columns.items()} for row in range(len(table))]
