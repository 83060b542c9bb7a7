"""The scoring grid: the epochs at which truth and decisions meet.

Times are nanoseconds on the recording's clock; arrays have one value per epoch, shape ``(n,)``.
"""

from collections.abc import Sequence

import numpy as np

from spoofbench.arrays import Bools, Floats, Times, ragged_arange
from spoofbench.detector import Decisions
from spoofbench.errors import LimitError, RecordingError
from spoofbench.recording import (
    Interval,
    Recording,
    attacked_intervals,
    clean_intervals,
    is_really_attacked,
)
from spoofbench.results import Truth
from spoofbench.table import Table

GUARD_S = 10.0
"""Least length of the release guard after an attack."""

LONGEST_DEFAULT_HOLD_S = 10.0
"""Longest interval between a detector's own decisions that :func:`default_hold_s` bridges."""

MAX_EPOCHS = 5_000_000
"""Largest grid; a recording whose clock jumps by years would need more."""


def build_truth(clean: Recording, variant: Recording) -> Truth:
    """Return the scoring grid of a variant; an unattacked one is its own clean recording.

    So is a really attacked one, for its epochs; but where the truth would have been is unknown, and
    so are the errors.

    The grid has the epochs of the variant's primary PVT, the clean epochs that the variant lacks,
    and nominal epochs in what gaps remain. Its nominal interval is the median interval of the clean
    epochs.

    Raises:
        RecordingError: the clean recording has fewer than two epochs.
        LimitError: the gaps need more than :data:`MAX_EPOCHS` nominal epochs.
    """
    base = _epochs(clean)
    if len(base) < 2:
        raise RecordingError(
            f"a recording with {len(base)} 'gnss/pvt' epochs cannot be scored: two are needed"
        )
    epoch_ns = int(np.median(np.diff(base.time_ns)))
    attacked = _epochs(variant)
    lost = ~_near(base.time_ns, attacked.time_ns, epoch_ns // 2)
    time_ns = _with_nominal(np.union1d(attacked.time_ns, base.time_ns[lost]), epoch_ns)
    intervals = attacked_intervals(variant)
    spoofed = within(time_ns, intervals)
    reviewed = np.ones(time_ns.size, bool)
    reported, true = _at(attacked, time_ns), _at(base, time_ns)
    if is_really_attacked(variant):
        reviewed = spoofed | within(time_ns, clean_intervals(variant))
        true = {name: np.full(time_ns.size, np.nan) for name in true}
    return Truth(
        time_ns=time_ns,
        observed=np.isin(time_ns, attacked.time_ns),
        spoofed=spoofed,
        guard=release_guard(time_ns, intervals, 0.0) & ~spoofed,
        reviewed=reviewed,
        lat_deg=reported["lat_deg"],
        lon_deg=reported["lon_deg"],
        clean_lat_deg=true["lat_deg"],
        clean_lon_deg=true["lon_deg"],
        position_error_m=_position_error_m(reported, true),
        velocity_error_mps=_norm(
            [reported[name] - true[name] for name in ("vel_n_mps", "vel_e_mps", "vel_d_mps")]
        ),
        epoch_ns=epoch_ns,
        intervals=intervals,
    )


def within(time_ns: Times, intervals: Sequence[Interval]) -> Bools:
    """Return which times lie within one of the intervals, shape ``(n,)``."""
    inside = np.zeros(time_ns.size, bool)
    for interval in intervals:
        inside |= interval.covers(time_ns)
    return inside


def release_guard(time_ns: Times, intervals: Sequence[Interval], memory_s: float) -> Bools:
    """Return which times lie within the guard after an interval, shape ``(n,)``.

    The guard lasts :data:`GUARD_S`, or ``memory_s`` where that is longer.
    """
    length_ns = round(max(GUARD_S, memory_s) * 1e9)
    return within(
        time_ns, [Interval(interval.end_ns, interval.end_ns + length_ns) for interval in intervals]
    )


def default_hold_s(epoch_ns: int, clean_decision_time_ns: Times) -> float:
    """Return how long a decision stands where the suite does not say, in seconds.

    It is 1.1 times the median PVT interval, or, where that is longer, the median interval of the
    detector's own decisions on the clean recording, but at most 10 s of it: a detector that
    decides less often than fixes come is available in between, one that decides when it likes is
    not. The tenth is for jitter.

    Args:
        epoch_ns: nominal interval of the grid.
        clean_decision_time_ns: of the detector on the clean recording, available or not, ``(m,)``.
    """
    own_ns = 0.0
    if clean_decision_time_ns.size > 1:
        own_ns = float(np.median(np.diff(clean_decision_time_ns)))
    return 1.1 * max(epoch_ns, min(own_ns, LONGEST_DEFAULT_HOLD_S * 1e9)) / 1e9


def score_on_grid(decisions: Decisions, truth: Truth, hold_s: float) -> Floats:
    """Return the score that holds at each epoch, shape ``(n,)``, NaN where unavailable.

    An epoch takes the latest decision up to it that is not older than ``hold_s``. Where there is
    none, or it is unavailable, so is the epoch.
    """
    if decisions.time_ns.size == 0:
        return np.full(truth.time_ns.size, np.nan)
    latest = np.searchsorted(decisions.time_ns, truth.time_ns, "right") - 1
    age_ns = truth.time_ns - decisions.time_ns[np.maximum(latest, 0)]
    fresh = (latest >= 0) & (age_ns <= round(hold_s * 1e9))
    return np.where(fresh, decisions.score[latest], np.nan)


def _epochs(recording: Recording) -> Table:
    """The primary PVT, one row per time; empty where the attack does not model it."""
    if not recording.topics("gnss/pvt"):
        return Table("gnss/pvt", np.empty(0, np.int64), {})
    return recording.primary("gnss/pvt").last_per_time()


def _near(time_ns: Times, others: Times, distance_ns: int) -> Bools:
    """Which times have one of the others at most this far away."""
    if others.size == 0:
        return np.zeros(time_ns.size, bool)
    after = np.searchsorted(others, time_ns).clip(0, others.size - 1)
    before = (after - 1).clip(0)
    near: Bools = (
        np.minimum(abs(others[after] - time_ns), abs(others[before] - time_ns)) <= distance_ns
    )
    return near


def _with_nominal(time_ns: Times, epoch_ns: int) -> Times:
    """Fill gaps with epochs at whole intervals after the last one before the gap."""
    missing = np.maximum((np.diff(time_ns) + epoch_ns // 2) // epoch_ns - 1, 0)
    if time_ns.size + int(missing.sum()) > MAX_EPOCHS:
        raise LimitError(
            f"the gaps between the 'gnss/pvt' epochs need {int(missing.sum())} nominal epochs, "
            f"more than {MAX_EPOCHS}; split the recording"
        )
    counts = np.append(missing + 1, 1)
    filled: Times = np.repeat(time_ns, counts) + ragged_arange(counts) * epoch_ns
    return filled


def _at(table: Table, time_ns: Times) -> dict[str, Floats]:
    """The PVT fields that the truth compares, at equal times; NaN elsewhere."""
    row = np.searchsorted(table.time_ns, time_ns).clip(0, max(len(table) - 1, 0))
    equal = table.time_ns[row] == time_ns if len(table) else np.zeros(time_ns.size, bool)
    names = "lat_deg lon_deg height_m height_msl_m vel_n_mps vel_e_mps vel_d_mps"
    columns = {name: np.full(time_ns.size, np.nan) for name in names.split()}
    for name, values in columns.items():
        values[equal] = table[name][row[equal]]
    return columns


def _position_error_m(reported: dict[str, Floats], true: dict[str, Floats]) -> Floats:
    """3-D distance; where either lacks the ellipsoidal height, both give that above mean sea
    level.
    """
    from pymap3d import geodetic2ecef

    no_height = np.isnan(reported["height_m"]) | np.isnan(true["height_m"])
    ecef_m = []
    for side in (reported, true):
        height_m = np.where(no_height, side["height_msl_m"], side["height_m"])
        ecef_m.append(np.stack(geodetic2ecef(side["lat_deg"], side["lon_deg"], height_m)))
    return _norm(list(ecef_m[0] - ecef_m[1]))


def _norm(components: list[Floats]) -> Floats:
    return np.sqrt(
        sum((component * component for component in components), start=np.zeros(components[0].size))
    )
