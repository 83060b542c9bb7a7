"""Lo et al.'s monitor on real logs: a car's drive and two model aircraft, clean and under simulated
replay.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from spoofbench_acceleration.monitor import AccelerationMonitor
from spoofbench_acceleration.statistics import exponential_average

from spoofbench.attacks.contract import Attack, attackable_span, draw_window, make_variant
from spoofbench.attacks.replay import RepeatBack, Replay
from spoofbench.codec import read
from spoofbench.conversion import convert
from spoofbench.demo import drive_bag
from spoofbench.detector import detect
from spoofbench.errors import NotApplicable, SpoofbenchError
from spoofbench.recording import Interval, Recording
from spoofbench_papers.reproduction import Cell, shown

FLIGHTS = ("fw_apm_testlog2.mat", "fw_px4_search_pattern.zip", "fw_arduplane_erle_E.BIN")

_WINDOWS = 5
_FLYING_MPS = 8.0
_CAR = AccelerationMonitor(axis="along_track", lag_s=0.34, mounting_pitch_deg=2.9)
_AIRCRAFT = AccelerationMonitor(lag_s=0.3)


@dataclass(frozen=True, slots=True)
class RealLog:
    """A recording, cut to what is judged, and how it is judged.

    Attributes:
        name: what is shown.
        recording: clean.
        monitors: by what distinguishes them.
        replay_s, window_s: delay and length of the replay's windows.
    """

    name: str
    recording: Recording
    monitors: Mapping[str, AccelerationMonitor]
    replay_s: float
    window_s: float


def logs(data: Path | None, with_drive: bool) -> tuple[list[RealLog], list[str]]:
    """Return the logs that are there, and a sentence on each that is not."""
    found, missing = [], []
    with TemporaryDirectory() as folder:
        if with_drive:
            try:
                found.append(_drive(Path(folder)))
            except SpoofbenchError as error:
                missing.append(f"The drive is left out: {error}.")
        else:
            missing.append("The drive is left out of the short form.")
        for name in FLIGHTS:
            file = data / "phone_bag" / name if data is not None else None
            if file is None or not file.exists():
                missing.append(f"The flight {name} is left out: it is not there.")
                continue
            try:
                found.append(_flight(file, Path(folder)))
            except SpoofbenchError as error:
                missing.append(f"The flight {name} is left out: {error}.")
    return found, missing


def agreement(monitor: AccelerationMonitor, recording: Recording) -> dict[str, float]:
    """Return how sensed and expected specific force of a recording agree.

    Returns:
        ``epochs`` at which both are known; ``correlation`` and ``correlation_averaged``, per epoch
        and after the monitor's averaging; ``mean_mps2`` and ``std_mps2`` of the averaged
        difference.
    """
    compared = monitor.compare(recording)
    both = ~np.isnan(compared.sensed_mps2 + compared.expected_mps2)
    time_s = (compared.time_ns[both] - compared.time_ns[0]) * 1e-9
    sensed, expected = compared.sensed_mps2[both], compared.expected_mps2[both]
    averages = [
        exponential_average(time_s, values, monitor.averaging_s, monitor.averaging)[0]
        for values in (sensed, expected)
    ]
    difference = averages[0] - averages[1]
    return {
        "epochs": int(both.sum()),
        "correlation": float(np.corrcoef(sensed, expected)[0, 1]),
        "correlation_averaged": float(np.corrcoef(averages[0], averages[1])[0, 1]),
        "mean_mps2": float(difference.mean()),
        "std_mps2": float(difference.std()),
    }


def rows(log: RealLog) -> Iterator[dict[str, Any]]:
    """Yield per monitor: correlations, difference, alerts of the clean log, and detection under two
    attacks in percent of their epochs.
    """
    for name, monitor in log.monitors.items():
        yield {
            "recording": log.name,
            "monitor": name,
            "lag_s": monitor.lag_s,
            **agreement(monitor, log.recording),
            "false_alert_pct": 100 * float(detect(monitor, log.recording).alert.mean()),
            "repeat_back_2s_pct": _detected(log, monitor, "repeat-back", RepeatBack()),
            "replay_s": log.replay_s,
            "replay_pct": _detected(log, monitor, "replay", Replay(delay_s=log.replay_s)),
        }


def cells(table: Sequence[Mapping[str, Any]]) -> Iterator[Cell]:
    """What the paper says of turns and of cars, on the logs that are there."""
    for item, recording, name, low, high in (
        ("a car's along-track axis without pitch", "drive", "along_track", -1.0, 0.90),
        ("a car's along-track axis with pitch, Eq (2)", "drive", "along_track, pitch", 0.98, 1.0),
        ("a car's vertical axis", "drive", "vertical", -1.0, 0.75),
        (
            "Fig 5 in kind: turning aircraft, vertical, no roll, averaged",
            "ArduPlane",
            "vertical",
            -1.0,
            0.75,
        ),
        (
            "Fig 6 in kind: turning aircraft, vertical, roll, averaged",
            "ArduPlane",
            "vertical, roll",
            0.95,
            1.0,
        ),
        (
            "Fig 5 in kind: turning aircraft, vertical, no roll, averaged",
            "PX4",
            "vertical",
            -1.0,
            0.75,
        ),
        (
            "Fig 6 in kind: turning aircraft, vertical, roll, averaged",
            "PX4",
            "vertical, roll",
            0.95,
            1.0,
        ),
    ):
        bound = f"at least {low}" if high == 1 else f"at most {high}"
        for row in table:
            if (row["recording"], row["monitor"]) == (recording, name):
                ours = row["correlation" if recording == "drive" else "correlation_averaged"]
                clean, repeated, replayed = (
                    shown(row[key])
                    for key in ("false_alert_pct", "repeat_back_2s_pct", "replay_pct")
                )
                yield Cell(
                    f"{item}: correlation ({recording})", None, ours, None, None,
                    "trend only" if low <= ours <= high else "not reproduced",
                    f"{bound} is wanted; alerts in {clean} % of the clean epochs, {repeated} % "
                    "under repeat-back by 2 s, "
                    f"{replayed} % under replay by {row['replay_s']:g} s",
                )  # fmt: skip


def _drive(folder: Path) -> RealLog:
    file = folder / "drive.mcap"
    convert(drive_bag(), file)
    monitors = {
        "along_track": _CAR,
        "along_track, pitch": replace(_CAR, pitch=True),
        "vertical": replace(_CAR, axis="vertical"),
    }
    return RealLog("drive", read(file), monitors, 300.0, 120.0)


def _flight(file: Path, folder: Path) -> RealLog:
    """The part of a flight between its first and last epoch faster than a model aircraft taxies."""
    converted = folder / f"{file.name}.mcap"
    convert(file, converted)
    recording = with_velocity(read(converted))
    pvt = recording.primary("gnss/pvt")
    flying = pvt.time_ns[np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"]) > _FLYING_MPS]
    monitors = {"vertical": _AIRCRAFT, "vertical, roll": replace(_AIRCRAFT, roll=True)}
    name = "PX4" if "px4" in file.name else "ArduPlane"
    return RealLog(name, recording.between(int(flying[0]), int(flying[-1])), monitors, 60.0, 30.0)


def with_velocity(recording: Recording) -> Recording:
    """North and east velocity from speed and course where the log has only these."""
    topic, pvt = recording.topics("gnss/pvt")[0], recording.primary("gnss/pvt")
    if np.isfinite(pvt["vel_n_mps"]).any():
        return recording
    course, speed = np.radians(pvt["course_deg"]), pvt["speed_mps"]
    return recording.replace(
        {topic: pvt.replace(vel_n_mps=speed * np.cos(course), vel_e_mps=speed * np.sin(course))}
    )


def _detected(
    log: RealLog, monitor: AccelerationMonitor, name: str, attack: Attack
) -> float | None:
    """Alerted share of the attacked epochs of windows drawn by seed, percent; None where the attack
    fits nowhere.
    """
    alerted, attacked = 0, 0
    for seed in range(_WINDOWS):
        try:
            window = draw_window(
                0, log.name, seed, attackable_span(attack, log.recording), log.window_s
            )
            variant = make_variant(name, attack, log.recording, window, seed)
        except NotApplicable:
            continue
        truth = variant["/truth/attack"]
        decisions = detect(monitor, variant)
        inside = Interval(int(truth["start_ns"][0]), int(truth["end_ns"][0])).covers(
            decisions.time_ns
        )
        alerted, attacked = (
            alerted + int(decisions.alert[inside].sum()),
            attacked + int(inside.sum()),
        )
    return 100 * alerted / attacked if attacked else None
