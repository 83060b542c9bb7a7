"""The doctor says nothing of a good drive, and names each mistake that was made in one."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from spoofbench.conversion import Ledger, Reject
from spoofbench.doctor import Finding, examine
from spoofbench.recording import Recording
from spoofbench.table import Table
from spoofbench.testing.recordings import START_NS, drive, spoofed_drive

PVT, IMU, MAG = "/gnss0/gnss/pvt", "/imu0/imu", "/car0/mag"
SECOND_NS = 1_000_000_000
GPS_EPOCH_S = 315_964_800
Change = Callable[[Recording], Recording]


@pytest.fixture(scope="module")
def good() -> Recording:
    """Ten minutes without a flaw; the receiver claims the week and time of week that its rows
    bear.
    """
    return claiming(drive(3, 600.0, flaws=False), 18.0)


def claiming(recording: Recording, ahead_s: float) -> Recording:
    pvt = recording[PVT]
    claimed = pvt.time_ns / 1e9 - GPS_EPOCH_S + ahead_s
    return edited(
        recording, PVT, gps_week=(claimed // 604_800).astype(int), tow_s=claimed % 604_800
    )


def edited(recording: Recording, topic: str, **columns: Any) -> Recording:
    return recording.replace({topic: recording[topic].replace(**columns)})


def scaled(topic: str, factor: float, *names: str) -> Change:
    return lambda recording: edited(
        recording, topic, **{name: recording[topic][name] * factor for name in names}
    )


def moved(recording: Recording, topic: str, seconds: float) -> Recording:
    table = recording[topic]
    columns = {name: table.column(name) for name in table}
    return recording.replace(
        {topic: Table(table.kind.name, table.time_ns + int(seconds * 1e9), columns)}
    )


def shifted_all(seconds: float) -> Change:
    def shift(recording: Recording) -> Recording:
        for topic in recording:
            recording = moved(recording, topic, seconds)
        return recording

    return shift


def described(name: str, **record: str) -> Change:
    return lambda recording: recording.with_metadata(
        {name: {**recording.metadata.get(name, {}), **record}}
    )


def speed_only(recording: Recording) -> Recording:
    """The receiver says speed and course instead of a velocity."""
    pvt = recording[PVT]
    course = np.degrees(np.arctan2(pvt["vel_e_mps"], pvt["vel_n_mps"])) % 360
    speed = np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"])
    return edited(
        recording,
        PVT,
        speed_mps=speed,
        course_deg=course,
        vel_n_mps=None,
        vel_e_mps=None,
        vel_d_mps=None,
    )


def received(topic: str, delay_s: float) -> Change:
    return lambda recording: edited(
        recording, topic, receive_time_ns=recording[topic].time_ns + int(delay_s * 1e9)
    )


def with_rows(topic: str, rows: Any) -> Change:
    return lambda recording: recording.replace(
        {topic: recording[topic].take(rows(len(recording[topic])))}
    )


def codes(findings: list[Finding], worse_than_info: bool = True) -> set[str]:
    return {
        finding.code for finding in findings if finding.severity != "info" or not worse_than_info
    }


@pytest.mark.parametrize("seed", range(6))
def test_a_good_drive_has_nothing_wrong(seed: int) -> None:
    assert (
        codes(examine(claiming(drive(seed, 400.0, 5.0, flaws=False, second_sources=True), 18.0)))
        == set()
    )
    assert codes(examine(speed_only(drive(seed, 400.0, flaws=False)))) == set()


def test_flaws_are_gaps(good: Recording) -> None:
    findings = {
        finding.topic: finding for finding in examine(drive(1, 400.0)) if finding.code == "rate-gap"
    }
    assert findings[PVT].severity == "warning"
    assert findings[IMU].severity == "info"
    assert "the longest 9 s where rows come every 1 s" in findings[PVT].text


def hold(recording: Recording) -> Recording:
    """Positions stay for 25 s in the middle of the fastest stretch, with no word."""
    pvt = recording[PVT]
    middle = int(
        np.argmax(np.convolve(np.hypot(pvt["vel_n_mps"], pvt["vel_e_mps"]), np.ones(25), "valid"))
    )
    lat, lon = pvt["lat_deg"].copy(), pvt["lon_deg"].copy()
    lat[middle : middle + 25], lon[middle : middle + 25] = lat[middle], lon[middle]
    return edited(recording, PVT, lat_deg=lat, lon_deg=lon)


def jump(field: str, degrees: float) -> Change:
    def change(recording: Recording) -> Recording:
        values = recording[PVT][field].copy()
        values[100:] += degrees
        return edited(recording, PVT, **{field: values})

    return change


def nulls(recording: Recording) -> Recording:
    lat, lon = recording[PVT]["lat_deg"].copy(), recording[PVT]["lon_deg"].copy()
    lat[:5] = lon[:5] = 0
    return edited(recording, PVT, lat_deg=lat, lon_deg=lon)


def clipped(recording: Recording) -> Recording:
    values = recording[IMU]["accel_x_mps2"].copy()
    values[1000:1010], values[2000:2006] = 2 * 9.80665, -2 * 9.80665
    return edited(recording, IMU, accel_x_mps2=values)


def repeated(recording: Recording) -> Recording:
    changed = {}
    for name in (
        "accel_x_mps2",
        "accel_y_mps2",
        "accel_z_mps2",
        "gyro_x_radps",
        "gyro_y_radps",
        "gyro_z_radps",
    ):
        values = recording[IMU][name].copy()
        values[500:600] = values[500]
        changed[name] = values
    return edited(recording, IMU, **changed)


def doubled(recording: Recording) -> Recording:
    pvt = recording[PVT]
    rows = np.sort(np.concatenate([np.arange(len(pvt)), np.arange(0, len(pvt), 3)]))
    table = pvt.take(rows)
    lat = table["lat_deg"] + np.append(np.diff(rows) == 0, False) * 1e-5
    return recording.replace({PVT: table.replace(lat_deg=lat)})


def stretched(recording: Recording) -> Recording:
    """The board's clock runs at 12/13 of GNSS time, and everything is stamped by it."""
    for topic in recording:
        table = recording[topic]
        times = START_NS + (table.time_ns - START_NS) // 13 * 12
        recording = recording.replace(
            {topic: Table(table.kind.name, times, {name: table.column(name) for name in table})}
        )
    return recording


def thinned_half(recording: Recording) -> Recording:
    n = len(recording[PVT])
    return recording.replace(
        {PVT: recording[PVT].take(np.concatenate([np.arange(n // 2), np.arange(n // 2, n, 4)]))}
    )


def ledger(reason: str) -> Change:
    account = Ledger("bytes", 900)
    account.enter(Reject(0, 100, reason))
    return lambda recording: recording.with_metadata({"ledger": account.as_metadata()})


def second(recording: Recording) -> Recording:
    """The same rows as of a second receiver."""
    return recording.replace({"/gnss1/gnss/pvt": recording[PVT]})


def week_off(recording: Recording) -> Recording:
    return edited(recording, PVT, gps_week=recording[PVT]["gps_week"] - 1024)


GYRO = ("gyro_x_radps", "gyro_y_radps", "gyro_z_radps")
ACCEL = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")
FIELD = ("field_x_ut", "field_y_ut", "field_z_ut")
VELOCITY = ("vel_n_mps", "vel_e_mps")
STEPS = {
    "clock_step_count": "2",
    "clock_steps": json.dumps([{"offset": 7, "from_ns": 0, "to_ns": SECOND_NS}]),
}

HUGE_STEP = json.dumps([{"from_ns": 0, "to_ns": 10**400}])

MISTAKES: dict[str, tuple[Change, str, str]] = {
    "velocity in km/h": (scaled(PVT, 3.6, *VELOCITY), "speed-unit", "error"),
    "speed in knots": (
        lambda r: scaled(PVT, 1.943844, "speed_mps")(speed_only(r)),
        "speed-unit",
        "error",
    ),
    "speed from m/s as knots": (
        lambda r: scaled(PVT, 1 / 1.943844, "speed_mps")(speed_only(r)),
        "speed-unit",
        "error",
    ),
    "speed half as large": (
        lambda r: scaled(PVT, 0.7, "speed_mps")(speed_only(r)),
        "speed-disagrees",
        "warning",
    ),
    "course in radians": (
        lambda r: scaled(PVT, np.radians(1), "course_deg")(speed_only(r)),
        "course-unit",
        "error",
    ),
    "course from east": (
        lambda r: edited(
            speed_only(r), PVT, course_deg=(90 - speed_only(r)[PVT]["course_deg"]) % 360
        ),
        "course-unit",
        "error",
    ),
    "ENU as NED": (
        lambda r: edited(r, PVT, vel_n_mps=r[PVT]["vel_e_mps"], vel_e_mps=r[PVT]["vel_n_mps"]),
        "velocity-frame",
        "error",
    ),
    "gyro in deg/s": (scaled(IMU, np.degrees(1), *GYRO), "gyro-unit", "error"),
    "gyro times pi/180 twice": (scaled(IMU, np.radians(1), *GYRO), "gyro-unit", "error"),
    "gyro mirrored": (scaled(IMU, -1.0, *GYRO), "gyro-sign", "warning"),
    "gyro beyond any range": (scaled(IMU, 1e4, *GYRO), "gyro-range", "warning"),
    "gyro scale": (scaled(IMU, 1.3, *GYRO), "gyro-scale", "warning"),
    "IMU 1.2 s late": (lambda r: moved(r, IMU, 1.2), "imu-lag", "warning"),
    "IMU 3 s early": (lambda r: moved(r, IMU, -3.0), "imu-lag", "error"),
    "IMU in GPS time": (lambda r: moved(r, IMU, 18.0), "imu-lag", "error"),
    "second receiver in GPS time": (
        lambda r: moved(second(r), "/gnss1/gnss/pvt", 18.0),
        "gps-time-as-utc",
        "error",
    ),
    "second receiver's height": (
        lambda r: edited(
            second(edited(r, PVT, height_msl_m=r[PVT]["height_m"] - 47)),
            "/gnss1/gnss/pvt",
            height_m=r[PVT]["height_m"] - 47,
        ),
        "height-datum",
        "warning",
    ),
    "accelerometer in g": (scaled(IMU, 1 / 9.80665, *ACCEL), "accel-unit", "error"),
    "accelerometer times g twice": (scaled(IMU, 9.80665, *ACCEL), "accel-unit", "error"),
    "accelerometer mirrored": (scaled(IMU, -1.0, *ACCEL), "accel-sign", "error"),
    "accelerometer without gravity": (
        lambda r: edited(r, IMU, accel_z_mps2=r[IMU]["accel_z_mps2"] + 9.81),
        "accel-without-gravity",
        "error",
    ),
    "accelerometer off": (scaled(IMU, 1.4, *ACCEL), "accel-scale", "warning"),
    "accelerometer clipped": (clipped, "imu-saturated", "warning"),
    "magnetometer in gauss": (scaled(MAG, 0.01, *FIELD), "mag-unit", "error"),
    "magnetometer in milligauss": (scaled(MAG, 10.0, *FIELD), "mag-unit", "error"),
    "magnetometer in gauss declared tesla": (scaled(MAG, 1e4, *FIELD), "mag-unit", "error"),
    "magnetometer in tesla": (scaled(MAG, 1e-6, *FIELD), "mag-unit", "error"),
    "magnetometer off": (scaled(MAG, 0.1, *FIELD), "mag-scale", "warning"),
    "magnetometer beside iron": (
        lambda r: edited(r, MAG, field_x_ut=r[MAG]["field_x_ut"] + 400),
        "mag-bias",
        "info",
    ),
    "IMU frozen": (repeated, "frozen-imu", "warning"),
    "gyro absent as 0": (scaled(IMU, 0.0, *GYRO), "all-zero", "error"),
    "IMU decimated": (
        lambda r: edited(with_rows(IMU, lambda n: np.arange(0, n, 100))(r), IMU, interval_s=None),
        "slow-imu",
        "warning",
    ),
    "position held": (hold, "held-position", "warning"),
    "position held in a fast table": (
        lambda r: r.replace({PVT: _faster(r[PVT], 5)}),
        "held-position",
        "warning",
    ),
    "position jumps 200 m": (jump("lat_deg", 0.0018), "position-jump", "warning"),
    "position jumps 11 km": (jump("lon_deg", 0.15), "position-jump", "error"),
    "height jumps": (jump("height_m", 60.0), "height-jump", "warning"),
    "null island": (nulls, "impossible-position", "error"),
    "latitude 100": (jump("lat_deg", 100.0), "impossible-position", "error"),
    "heights equal": (
        lambda r: edited(r, PVT, height_msl_m=r[PVT]["height_m"]),
        "height-datum",
        "warning",
    ),
    "heights 300 m apart": (
        lambda r: edited(r, PVT, height_msl_m=r[PVT]["height_m"] - 300),
        "height-datum",
        "warning",
    ),
    "accuracy absent as 0": (scaled(PVT, 0.0, "h_acc_m"), "all-zero", "warning"),
    "two rows per epoch": (doubled, "repeated-epoch", "warning"),
    "rate changes": (thinned_half, "rate-change", "warning"),
    "week 1024 off": (week_off, "week-rollover", "error"),
    "dates 1024 weeks off": (lambda r: received(PVT, 1024 * 604_800)(r), "week-rollover", "error"),
    "date in the name": (
        described("origin", file="drive_2043-07-01.nmea"),
        "week-rollover",
        "error",
    ),
    "year in the name": (described("origin", file="harbour_2043.nmea"), "week-rollover", "error"),
    "GPS time as UTC": (lambda r: claiming(r, 0.0), "gps-time-as-utc", "error"),
    "GPS time as UTC, by receipt": (received(PVT, -17.9), "gps-time-as-utc", "warning"),
    "old leap seconds": (
        lambda r: described("recording", clock="gnss")(claiming(r, 16.0)),
        "leap-seconds",
        "warning",
    ),
    "local time": (received(PVT, 2 * 3600 + 0.3), "local-time-as-utc", "error"),
    "local time of one sensor": (lambda r: moved(r, PVT, 5.5 * 3600), "local-time-as-utc", "error"),
    "no date": (shifted_all(-START_NS / 1e9 + 100), "no-date", "warning"),
    "no date of one sensor": (
        lambda r: moved(r, PVT, -START_NS / 1e9 + 100),
        "default-date",
        "error",
    ),
    "week 0": (
        lambda r: edited(
            r, PVT, gps_week=np.where(np.arange(len(r[PVT])) < 5, 0, r[PVT]["gps_week"])
        ),
        "default-date",
        "warning",
    ),
    "clock steps noted": (described("recording", **STEPS), "clock-step", "warning"),
    "clock steps seen": (
        lambda r: edited(r, PVT, tow_s=r[PVT]["tow_s"] + 5.0 * (np.arange(len(r[PVT])) > 300)),
        "clock-step",
        "warning",
    ),
    "clock of 12/13": (stretched, "clock-drift", "error"),
    "fused primary": (described("source/gnss0", solution="fused"), "fused-primary", "warning"),
    "no receiver": (lambda r: r.replace({PVT: None}), "missing-kind", "warning"),
    "lost bytes": (ledger("UBX: checksum wrong"), "loss", "warning"),
    "nothing": (lambda r: Recording({}), "empty", "error"),
}


def _faster(pvt: Table, times: int) -> Table:
    """A table of more rows in which each epoch is repeated."""
    rows = np.repeat(np.arange(len(pvt)), times)
    time_ns = pvt.time_ns[rows] + np.tile(np.arange(times), len(pvt)) * SECOND_NS // times
    return Table(
        "gnss/pvt",
        time_ns,
        {name: pvt[name][rows] for name in ("lat_deg", "lon_deg", "vel_n_mps", "vel_e_mps")},
    )


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named(mistake: str, good: Recording) -> None:
    change, code, severity = MISTAKES[mistake]
    findings = [finding for finding in examine(change(good)) if finding.code == code]
    assert findings
    assert findings[0].severity == severity
    assert findings[0].advice
    assert np.isfinite(
        [value for finding in findings for value in (finding.start_ns or 0, finding.count or 0)]
    ).all()


def test_what_is_only_not_asked_for_is_no_warning(good: Recording) -> None:
    assert codes(examine(ledger("UBX ACK-ACK: nothing in the schema")(good))) == set()


def test_a_log_is_not_newer_than_its_recording_by_1024_weeks(good: Recording) -> None:
    later = described("origin", modified_ns=str(START_NS + 1024 * 604_800 * SECOND_NS))(good)
    assert "week-rollover" in codes(examine(later))
    assert (
        codes(
            examine(described("origin", modified_ns=str(START_NS + 90 * 86_400 * SECOND_NS))(good))
        )
        == set()
    )


def test_labels_that_fit_and_labels_that_do_not() -> None:
    spoofed = spoofed_drive(2, 400.0)
    assert not {code for code in codes(examine(spoofed)) if code.startswith("label")}
    truth = spoofed["/truth/attack"]
    for off_s, code in ((20, "label-onset"), (4000, "label-outside")):
        start_ns, end_ns = (
            truth["start_ns"] + off_s * SECOND_NS,
            truth["end_ns"] + off_s * SECOND_NS,
        )
        wrong = truth.replace(start_ns=start_ns, end_ns=end_ns)
        assert code in codes(examine(spoofed.replace({"/truth/attack": wrong})))


def test_a_clean_label_without_an_epoch_is_found() -> None:
    recording = drive(2, 120.0)
    for off_s, found in ((10, False), (4000, True)):
        start_ns = np.array([START_NS + off_s * SECOND_NS])
        bounds = {"start_ns": start_ns, "end_ns": start_ns + 20 * SECOND_NS}
        clean = Table("truth/clean", start_ns, bounds)
        labelled = recording.replace({"/truth/clean": clean})
        assert ("label-outside" in codes(examine(labelled))) == found


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan, 1e308, 0.0])
def test_any_values_give_findings_that_machines_can_read(value: float) -> None:
    recording = drive(1, 60.0)
    for topic in (PVT, IMU):
        table = recording[topic]
        columns = {
            name: np.full(len(table), value) for name in table if table[name].dtype.kind == "f"
        }
        recording = recording.replace({topic: table.replace(**columns)})
    strange = {"clock_step_count": "9" * 30, "clock_steps": "[[", "clock": "\x1b[2J"}
    recording = recording.with_metadata(
        {
            "recording": strange,
            "ledger": {"unit": "x"},
            "origin": {"modified_ns": "-", "file": "2024-13-99"},
        }
    )
    for finding in examine(recording):
        json.dumps(replace(finding).__class__.__slots__, allow_nan=False)
        assert finding.count is None or finding.count >= 0


@pytest.mark.parametrize(
    "steps", ["", "[", "[" * 100_000, "{}", "[3]", '[{"to_ns": 1}]', HUGE_STEP]
)
def test_steps_that_cannot_be_read_are_counted_all_the_same(steps: str, good: Recording) -> None:
    noted = described("recording", clock_step_count="2", clock_steps=steps)(good)
    (finding,) = [finding for finding in examine(noted) if finding.code == "clock-step"]
    assert finding.count == 2
    assert finding.text == "the clock that the log claims makes 2 steps"


def test_short_recordings_give_no_findings_that_need_more() -> None:
    for rows in (0, 1, 2, 3):
        recording = drive(1, 60.0)
        cut = Recording(
            {topic: recording[topic].take(slice(0, rows)) for topic in recording},
            recording.metadata,
        )
        assert codes(examine(cut)) <= {"empty"}
