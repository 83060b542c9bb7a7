"""Checks of what a recording holds: kinds, losses, rates and gaps, and labels of attacks."""

from collections.abc import Iterator

import numpy as np

from spoofbench.arrays import Floats, Times
from spoofbench.conversion import Ledger
from spoofbench.doctor.findings import Finding, Severity, extent, metadata_record
from spoofbench.doctor.motion import runs
from spoofbench.doctor.positions import jumps
from spoofbench.formatting import counted
from spoofbench.recording import Recording
from spoofbench.schema import CLEAN_TOPIC, LABEL_TOPICS, TRUTH_TOPIC, split_topic

GREAT_LOSS = 0.01
HARMLESS_REASONS = (
    "nothing in the schema",
    "not asked for",
    "not understood",
    "not in the mapping",
    "vendor's own",
    "of no type",
    "repeated",
    "again",
    "told ",
    "says more",
    "no value",
    "a poll",
    "comment",
    "blank",
)
"""Parts of the reasons that are no loss of what could have been used."""

MIN_ROWS_FOR_ZEROS = 10
NEVER_ZERO = {
    "gnss/pvt": (
        "h_acc_m",
        "v_acc_m",
        "s_acc_mps",
        "pdop",
        "hdop",
        "vdop",
        "num_sv",
        "height_m",
        "height_msl_m",
        "cov_nn_m2",
        "cov_dd_m2",
    ),
    "gnss/signal": ("cn0_dbhz",),
    "gnss/observation": ("pseudorange_m", "cn0_dbhz"),
    "baro": ("pressure_pa",),
    "mag": ("field_x_ut", "field_y_ut", "field_z_ut"),
}

REGULAR_KINDS = ("imu", "gnss/pvt", "mag", "baro", "ins/pva")
"""Kinds that come at a rate; others come when there is something to report."""

BLOCK = 25
"""Intervals whose median is one reading of the rate."""

GAP_FACTOR = 1.75
"""An interval longer than so many medians lacks an epoch."""

GRAVE_SHARE, GRAVE_GAP_S = 0.01, 10.0
"""Of the time without rows, and of the longest gap: what a detector has to be told about."""

HARMLESS_GAP_S = 0.1
"""In a sensor's rows: vehicles hardly change their motion in it, and phones sample as irregularly.
"""

SLIGHT_SHARE, SLIGHT_GAP_S = 1e-3, 1.0
"""Below both there is nothing to report: a lost sample of a fast sensor."""

CHANGE_FACTOR, LASTING_SHARE = 1.5, 0.05
"""A rate is another one from half as much again, for a twentieth of the time."""

SLOW_IMU_HZ = 10.0
"""Below, fewer than ten samples fall between two epochs at 1 Hz: accelerations of a vehicle reach
to some hertz.
"""

NEAR_LABEL_S = 60.0
"""How far from a label a jump is still taken to be the attack's."""


def kinds(recording: Recording) -> Iterator[Finding]:
    """Kinds and fields without which detectors cannot work."""
    if not any(len(recording[topic]) for topic in recording if topic not in LABEL_TOPICS):
        advice = "convert again, and look at the ledger"
        yield Finding("empty", "error", "", "the recording has no rows", advice)
        return
    topics = [topic for topic in recording.topics("gnss/pvt") if len(recording[topic])]
    if not topics:
        text = f"there is no gnss/pvt, only {', '.join(sorted(recording.kinds))}"
        advice = "no detector can be scored: scores count epochs of the primary gnss/pvt"
        yield Finding("missing-kind", "warning", "", text, advice)
        return
    topic, table = topics[0], recording[topics[0]]
    if not table.has("lat_deg", "lon_deg"):
        advice = "detectors of positions cannot run"
        yield Finding("missing-field", "warning", topic, "there are no positions", advice)
    if not (table.has("vel_n_mps", "vel_e_mps") or table.has("speed_mps")):
        advice = "detectors that compare velocity with the IMU cannot run"
        yield Finding("missing-field", "info", topic, "there is neither velocity nor speed", advice)
    if not recording.topics("imu"):
        advice = "detectors that compare GNSS with inertial data cannot run"
        yield Finding("missing-kind", "info", "", "there is no IMU", advice)


def fused(recording: Recording) -> Iterator[Finding]:
    """A solution that already contains the IMU, as the one that is compared with the IMU."""

    def is_fused(topic: str) -> bool:
        source = metadata_record(recording, f"source/{split_topic(topic)[0]}")
        return source.get("solution") == "fused"

    topics = recording.topics("gnss/pvt")
    if not topics or not is_fused(topics[0]):
        return
    others = [topic for topic in topics[1:] if not is_fused(topic)]
    text = (
        "the primary solution is fused with inertial sensors: comparing it with them proves little"
    )
    advice = (
        f"convert again with --source, or name {others[0]} primary"
        if others
        else "leave it out of rankings that compare GNSS with the IMU"
    )
    yield Finding("fused-primary", "warning", topics[0], text, advice)


def losses(recording: Recording) -> Iterator[Finding]:
    """What was lost when the log was converted, or when the file was written."""
    damage = metadata_record(recording, "damage")
    if damage:
        text = f"the file was cut off: {damage.get('lost_bytes', 'some')} bytes are lost"
        yield Finding("cut-off", "warning", "", text, "convert or copy it again")
    try:
        ledger = Ledger.of_metadata(metadata_record(recording, "ledger"))
    except (KeyError, ValueError, TypeError):  # there is none, or another program wrote it
        return
    units = ledger.used + ledger.skipped
    lost = {
        reason: count
        for reason, count in ledger.reasons.items()
        if not any(part in reason for part in HARMLESS_REASONS)
    }
    count, advice = sum(lost.values()), "see the ledger: spoofbench info"
    if units and count > GREAT_LOSS * units:
        reason = max(lost, key=lambda reason: lost[reason])
        text = (
            f"{100 * count / units:.1f} % of the log's {ledger.unit} gave no rows, most because "
            f"{reason}"
        )
        yield Finding("loss", "warning", "", text, advice, count)
    elif units and ledger.skipped > GREAT_LOSS * units:
        reason = ledger.reasons.most_common(1)[0][0]
        text = (
            f"{100 * ledger.skipped / units:.1f} % of the log's {ledger.unit} were not used, most "
            f"because {reason}"
        )
        yield Finding("loss", "info", "", text, advice, ledger.skipped)
    for reason, lost_units in lost.items():
        if not lost_units:
            advice = "copy or pack the log again, if it still exists"
            yield Finding("cut-off", "warning", "", reason, advice)


def zeros(recording: Recording) -> Iterator[Finding]:
    """Fields that report 0 in all rows where nothing is ever 0."""
    for topic in recording:
        table = recording[topic]
        for name in NEVER_ZERO.get(split_topic(topic)[1], ()):
            values = table[name][table.valid(name)] if name in table else np.zeros(0)
            if values.size >= MIN_ROWS_FOR_ZEROS and not values.any():
                text = f"{name} is 0 in all {values.size} rows that have it"
                advice = "absent was written as 0: leave the field out"
                yield Finding("all-zero", "warning", topic, text, advice, int(values.size))


def gaps(recording: Recording) -> Iterator[Finding]:
    """Intervals in which one epoch is missing, or more."""
    for topic in recording:
        kind = split_topic(topic)[1]
        if kind not in REGULAR_KINDS:
            continue
        times = np.unique(recording[topic].time_ns)
        intervals = np.diff(times)
        if intervals.size < BLOCK:
            continue
        median = float(np.median(intervals))
        minimum = 0.0 if kind == "gnss/pvt" else HARMLESS_GAP_S * 1e9
        long = intervals > np.maximum(GAP_FACTOR * _local_medians(intervals), minimum)
        missing_s = float((intervals[long] - median).sum()) / 1e9
        longest_s = float(intervals.max()) / 1e9
        share = missing_s * 1e9 / float(times[-1] - times[0])
        if not long.any() or (share < SLIGHT_SHARE and longest_s < SLIGHT_GAP_S):
            continue
        is_primary = topic == recording.topics(kind)[0]
        grave = is_primary and (share > GRAVE_SHARE or longest_s > GRAVE_GAP_S)
        severity: Severity = "warning" if grave else "info"
        text = (
            f"{counted(int(long.sum()), 'gap')}, {missing_s:.1f} s without rows, the longest "
            f"{longest_s:.3g} s where rows come every {median / 1e9:.3g} s"
        )
        advice = "count these epochs as unavailable, and look whether the log was cut"
        yield Finding("rate-gap", severity, topic, text, advice, **extent(times[1:][long]))


def rate_changes(recording: Recording) -> Iterator[Finding]:
    """Rates that change for good: another setting, or a device that could not keep up."""
    for topic in recording:
        if split_topic(topic)[1] not in REGULAR_KINDS:
            continue
        times = np.unique(recording[topic].time_ns)
        medians = _block_medians(np.diff(times))
        if medians.size < 4:
            continue
        usual = float(np.median(medians))
        firsts, lengths = runs(
            (medians > CHANGE_FACTOR * usual) | (medians < usual / CHANGE_FACTOR)
        )
        totals = [
            float(medians[first : first + length].sum())
            for first, length in zip(firsts, lengths, strict=True)
        ]
        lasting = np.array(totals) * (lengths > 1)
        if lasting.size and lasting.max() > LASTING_SHARE * float(medians.sum()):
            longest = int(np.argmax(lasting))
            first, length = int(firsts[longest]), int(lengths[longest])
            other = float(np.median(medians[first : first + length]))
            text = (
                f"the rate is {1e9 / usual:.3g} Hz, and {1e9 / other:.3g} Hz for "
                f"{100 * float(lasting[longest] / medians.sum()):.0f} % of the time"
            )
            span = int(times[first * BLOCK]), int(times[(first + length) * BLOCK])
            advice = "cut the log where the rate changes, or resample on purpose"
            yield Finding("rate-change", "warning", topic, text, advice, length * BLOCK, *span)


def _block_medians(intervals: Times) -> Floats:
    """Return the median of each whole block of intervals, ``(n // BLOCK,)``."""
    blocks = intervals[: intervals.size // BLOCK * BLOCK].reshape(-1, BLOCK)
    return np.asarray(np.median(blocks, axis=1))


def _local_medians(intervals: Times) -> Floats:
    """Return the median interval of each one's block, ``(n,)``, so that a slower stretch is not all
    gaps; what is left over counts to the last block.
    """
    medians = _block_medians(intervals)
    sizes = np.full(medians.size, BLOCK)
    sizes[-1:] += intervals.size % BLOCK
    return np.repeat(medians, sizes)


def repeated_epochs(recording: Recording) -> Iterator[Finding]:
    """Rows of one receiver that bear the same time."""
    for topic in recording.topics("gnss/pvt"):
        table = recording[topic]
        same = np.flatnonzero(np.diff(table.time_ns) == 0)
        if not same.size:
            continue
        lat, lon = table["lat_deg"], table["lon_deg"]
        differ = (lat[same] != lat[same + 1]) | (lon[same] != lon[same + 1])
        text = (
            f"{same.size} epochs have more than one row, {int(differ.sum())} with different "
            "positions"
        )
        advice = (
            "the last row of a time counts; a log of two receivers has to be converted with "
            "--source"
        )
        severity: Severity = "warning" if differ.any() else "info"
        rows = extent(table.time_ns[same])
        yield Finding("repeated-epoch", severity, topic, text, advice, **rows)


def slow_imu(recording: Recording) -> Iterator[Finding]:
    """Inertial data that were decimated."""
    for topic in recording.topics("imu"):
        table = recording[topic]
        intervals_s = np.diff(np.unique(table.time_ns)) / 1e9
        if intervals_s.size < BLOCK or np.median(intervals_s) <= 1 / SLOW_IMU_HZ:
            continue
        step_s = float(np.median(intervals_s))
        averaged = table.has("interval_s") and float(np.nanmedian(table["interval_s"])) > step_s / 2
        kind = "averages" if averaged else "samples, which alias the vibration between them"
        text = f"the IMU comes at {1 / step_s:.3g} Hz as {kind}"
        advice = "do not judge detectors by it that integrate inertial data between epochs"
        yield Finding("slow-imu", "info" if averaged else "warning", topic, text, advice)


def labels(recording: Recording) -> Iterator[Finding]:
    """Labelled intervals without an epoch, and jumps of the position near the start or end of an
    attack, with none at it.
    """
    if not LABEL_TOPICS & {*recording} or "gnss/pvt" not in recording.kinds:
        return
    pvt = recording.primary("gnss/pvt").last_per_time()
    steps, jump = jumps(pvt)
    jumped_ns = pvt.time_ns[steps.next_rows[jump]]
    advice = "check the time base of the labels"
    for topic, start_ns, end_ns in _labelled(recording):
        span = {"start_ns": start_ns, "end_ns": end_ns}
        epochs = pvt.time_ns[(pvt.time_ns >= start_ns) & (pvt.time_ns < end_ns)]
        if not epochs.size:
            text = "the labelled interval has no epoch in it"
            yield Finding("label-outside", "error", topic, text, advice, **span)
        if not epochs.size or topic == CLEAN_TOPIC:
            continue
        after = pvt.time_ns[pvt.time_ns >= end_ns]
        edges = {"start": int(epochs[0]), "end": int(after[0]) if after.size else end_ns}
        for edge, edge_ns in edges.items():
            off_s = (jumped_ns - edge_ns) / 1e9
            near_s = off_s[np.abs(off_s) < NEAR_LABEL_S]
            if near_s.size and not np.any(near_s == 0):
                nearest_s = float(near_s[np.argmin(np.abs(near_s))])
                text = (
                    f"the position jumps {abs(nearest_s):.1f} s "
                    f"{'before' if nearest_s < 0 else 'after'} the {edge} of the labelled attack"
                )
                count = int(near_s.size)
                yield Finding("label-onset", "warning", TRUTH_TOPIC, text, advice, count, **span)


def _labelled(recording: Recording) -> Iterator[tuple[str, int, int]]:
    """Yield the topic, start and end of each interval that is labelled attacked or clean."""
    for topic in sorted(LABEL_TOPICS & {*recording}):
        starts, ends = (recording[topic][name].tolist() for name in ("start_ns", "end_ns"))
        yield from ((topic, *bounds) for bounds in zip(starts, ends, strict=True))
