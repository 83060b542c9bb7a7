"""Checks of what a recording holds, where it is from, and of its labels."""

import numpy as np

from spoofbench.conversion import Ledger
from spoofbench.doctor.finding import Finding, facts
from spoofbench.doctor.positions import jumps
from spoofbench.recording import Recording
from spoofbench.schema import TRUTH_TOPIC, split_topic

GREAT_LOSS = 0.01
ABOUT_S = 60.0
"""How far from a label a jump is still taken to be the attack's."""

ADVICE = "check the time base of the labels"

LEAST_FOR_ZEROS = 10
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
_HARMLESS = (
    *(
        "nothing in the schema",
        "not asked for",
        "not understood",
        "not in the mapping",
        "vendor's own",
        "of no type",
    ),
    *("repeated", "again", "told ", "says more", "no value", "a poll", "comment", "blank"),
)
"""Words of the reasons that are no loss of what could have been used."""


def kinds(recording: Recording) -> list[Finding]:
    """Kinds without which detectors cannot work."""
    findings = []
    if not any(len(recording[topic]) for topic in recording if topic != TRUTH_TOPIC):
        return [
            Finding(
                "empty",
                "error",
                "",
                "the recording has no rows",
                "convert again, and look at the ledger",
            )
        ]
    pvt = [topic for topic in recording.topics("gnss/pvt") if len(recording[topic])]
    if not pvt:
        text = f"there is no gnss/pvt, only {', '.join(sorted(recording.kinds))}"
        return [
            Finding(
                "missing-kind",
                "warning",
                "",
                text,
                "no detector can be scored: scores count epochs of the primary gnss/pvt",
            )
        ]
    table = recording[pvt[0]]
    if not table.has("lat_deg", "lon_deg"):
        findings.append(
            Finding(
                "missing-field",
                "warning",
                pvt[0],
                "there are no positions",
                "detectors of positions cannot run",
            )
        )
    if not (table.has("vel_n_mps", "vel_e_mps") or table.has("speed_mps")):
        text = "there is neither velocity nor speed"
        findings.append(
            Finding(
                "missing-field",
                "info",
                pvt[0],
                text,
                "detectors that compare velocity with the IMU cannot run",
            )
        )
    if not recording.topics("imu"):
        findings.append(
            Finding(
                "missing-kind",
                "info",
                "",
                "there is no IMU",
                "detectors that compare GNSS with inertial data cannot run",
            )
        )
    return findings


def fused(recording: Recording) -> list[Finding]:
    """A solution that already contains the IMU, as the one that is compared with the IMU."""
    topics = recording.topics("gnss/pvt")
    if not topics:
        return []
    source = split_topic(topics[0])[0]
    if facts(recording, f"source/{source}").get("solution") != "fused":
        return []
    others = [
        topic
        for topic in topics[1:]
        if facts(recording, f"source/{split_topic(topic)[0]}").get("solution") != "fused"
    ]
    advice = (
        f"convert again with --source, or name {others[0]} primary"
        if others
        else "leave it out of rankings that compare GNSS with the IMU"
    )
    text = (
        "the primary solution is fused with inertial sensors: comparing it with them proves little"
    )
    return [Finding("fused-primary", "warning", topics[0], text, advice)]


def zeros(recording: Recording) -> list[Finding]:
    """Fields that say 0 in all rows where nothing is ever 0."""
    findings = []
    for topic in recording:
        table = recording[topic]
        for name in NEVER_ZERO.get(split_topic(topic)[1], ()):
            said = table[name][table.valid(name)] if name in table else np.zeros(0)
            if said.size >= LEAST_FOR_ZEROS and not said.any():
                text = f"{name} is 0 in all {said.size} rows that have it"
                findings.append(
                    Finding(
                        "all-zero",
                        "warning",
                        topic,
                        text,
                        "absent was written as 0: leave the field out",
                        int(said.size),
                    )
                )
    return findings


def losses(recording: Recording) -> list[Finding]:
    """What was lost when the log was converted, or when the file was written."""
    findings = []
    damage = facts(recording, "damage")
    if damage:
        text = f"the file was cut off: {damage.get('lost_bytes', 'some')} bytes are lost"
        findings.append(Finding("cut-off", "warning", "", text, "convert or copy it again"))
    try:
        ledger = Ledger.of_metadata(facts(recording, "ledger"))
    except (KeyError, ValueError, TypeError):  # there is none, or another program wrote it
        return findings
    units = ledger.used + ledger.skipped
    lost = {
        reason: count
        for reason, count in ledger.reasons.items()
        if not any(word in reason for word in _HARMLESS)
    }
    cut = [reason for reason, count in lost.items() if not count]
    if units and sum(lost.values()) > GREAT_LOSS * units:
        reason = max(lost, key=lambda reason: lost[reason])
        text = (
            f"{100 * sum(lost.values()) / units:.1f} % of the log's {ledger.unit} gave no rows, "
            f"most because {reason}"
        )
        findings.append(
            Finding(
                "loss", "warning", "", text, "see the ledger: spoofbench info", sum(lost.values())
            )
        )
    elif units and ledger.skipped > GREAT_LOSS * units:
        reason = ledger.reasons.most_common(1)[0][0]
        text = (
            f"{100 * ledger.skipped / units:.1f} % of the log's {ledger.unit} were not used, most "
            f"because {reason}"
        )
        findings.append(
            Finding("loss", "info", "", text, "see the ledger: spoofbench info", ledger.skipped)
        )
    findings += [
        Finding("cut-off", "warning", "", reason, "copy or pack the log again, if it still exists")
        for reason in cut
    ]
    return findings


def labels(recording: Recording) -> list[Finding]:
    """Attack intervals without an epoch, and jumps of the position beside their start or end, with
    none at it.
    """
    if TRUTH_TOPIC not in recording or "gnss/pvt" not in recording.kinds:
        return []
    truth, pvt = recording[TRUTH_TOPIC], recording.primary("gnss/pvt").last_per_time()
    way, jump = jumps(pvt)
    jumped_ns = pvt.time_ns[way.next_rows[jump]]
    findings = []
    for start_ns, end_ns in zip(truth["start_ns"].tolist(), truth["end_ns"].tolist(), strict=True):
        span = {"start_ns": start_ns, "end_ns": end_ns}
        epochs = pvt.time_ns[(pvt.time_ns >= start_ns) & (pvt.time_ns < end_ns)]
        if not epochs.size:
            text = "the attack's interval has no epoch in it"
            findings.append(Finding("label-outside", "error", TRUTH_TOPIC, text, ADVICE, **span))
            continue
        after = pvt.time_ns[pvt.time_ns >= end_ns]
        edges = {"start": int(epochs[0]), "end": int(after[0]) if after.size else end_ns}
        for edge, edge_ns in edges.items():
            off_s = (jumped_ns - edge_ns) / 1e9
            near = off_s[np.abs(off_s) < ABOUT_S]
            if near.size and not np.any(near == 0):
                nearest = float(near[np.argmin(np.abs(near))])
                text = (
                    f"the position jumps {abs(nearest):.1f} s "
                    f"{'before' if nearest < 0 else 'after'} the {edge} of the labelled attack"
                )
                findings.append(
                    Finding(
                        "label-onset", "warning", TRUTH_TOPIC, text, ADVICE, int(near.size), **span
                    )
                )
    return findings
