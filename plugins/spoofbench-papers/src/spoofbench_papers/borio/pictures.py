"""Pictures of the reproduction of Borio."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from spoofbench_correlation import gravity
from spoofbench_correlation.series import SeriesName, receiver_velocity, series

from spoofbench.navigation.imu import interval_means
from spoofbench_papers.borio.cells import Findings
from spoofbench_papers.borio.recordings import FieldSession
from spoofbench_papers.borio.statistics import DELAYS_S, FOUR, THRESHOLD, Row, Values
from spoofbench_papers.figures import new_figure, save_figure
from spoofbench_papers.reproduction import Picture

COLOURS = {"M_acc": "#c46a1b", "M_ag": "#3b6fb6", "H_acc": "#8c3b0c", "H_ag": "#14325c"}
STRETCH_S = (300.0, 900.0)


def time_series(path: Path, session: FieldSession) -> None:
    """Draw horizontal acceleration and yaw rate of IMU and GNSS over ten minutes (Figs 7, 10 and
    14).
    """
    velocity = receiver_velocity(session.recording.primary("gnss/pvt"))
    start_ns, end_ns = velocity.time_ns[:-1], velocity.time_ns[1:]
    means = interval_means(session.recording.primary("imu"), start_ns, end_ns)
    rest = gravity.low_pass(means.force_mps2.T, (end_ns - start_ns) / 1e9, 30.0)
    time_s = (end_ns - velocity.time_ns[0]) / 1e9
    first = STRETCH_S[0] if time_s[-1] > STRETCH_S[1] else 0.0
    shown = (time_s >= first) & (time_s < first + STRETCH_S[1] - STRETCH_S[0])
    figure, axes = new_figure(9.0, 4.6, rows=2)
    panels: tuple[tuple[SeriesName, str], ...] = (
        ("H_acc", "horizontal acceleration, m/s²"),
        ("H_ag", "yaw rate, rad/s"),
    )
    for panel, (comparison, label) in zip(axes, panels, strict=True):
        felt, claimed = series(comparison, means, rest, velocity)
        panel.plot(time_s[shown], claimed[shown], lw=1.6, color="#c46a1b", label="GNSS")
        panel.plot(time_s[shown], felt[shown], lw=0.8, color="#14325c", label="IMU")
        panel.set_ylabel(label, fontsize=9)
        panel.margins(x=0)
    axes[0].legend(fontsize=8, ncols=2, loc="upper right")
    axes[1].set_xlabel("time, s")
    save_figure(figure, path)


def statistics(path: Path, values: Values, shown: Sequence[tuple[str, str]]) -> None:
    """Draw the four statistics over time, a panel per session and case (Figs 8, 9, 11, 12 and
    13).
    """
    figure, axes = new_figure(9.0, 1.0 + 2.4 * len(shown), rows=len(shown))
    for panel, (name, case) in zip(np.atleast_1d(axes), shown, strict=True):
        for statistic in FOUR:
            found = values[name, case, statistic]
            gaps = np.flatnonzero(np.diff(found.time_s) > 10) + 1
            panel.plot(
                np.insert(found.time_s, gaps, np.nan),
                np.insert(found.value, gaps, np.nan),
                color=COLOURS[statistic],
                lw=1,
                label=statistic,
            )
        panel.axhline(THRESHOLD, color="k", lw=0.6, ls="--")
        panel.set_ylim(-1, 1)
        panel.margins(x=0)
        panel.set_title(f"{name}, {case}", fontsize=9)
        panel.set_ylabel("correlation", fontsize=9)
    np.atleast_1d(axes)[0].legend(fontsize=8, ncols=4, loc="lower right")
    np.atleast_1d(axes)[-1].set_xlabel("time, s")
    save_figure(figure, path)


def delays(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    """Draw the share of epochs with H below the paper's threshold over the replay's delay."""
    figure, axes = new_figure(7.0, 4.0)
    for name in names:
        points = sorted(
            (0 if row["case"] == "genuine" else int(row["case"][7:-1]), row["share_below_0_7"])
            for row in rows
            if row["recording"] == name
            and row["statistic"] == "H"
            and not row["case"].startswith("meacon")
            and row["epochs"]
        )
        if len(points) > 1:
            axes.plot(*zip(*points, strict=True), marker=".", label=name)
    axes.set_xscale("symlog", linthresh=1)
    axes.set_xticks([0, *DELAYS_S], ["0", *map(str, DELAYS_S)])
    axes.set_xlabel("delay, s")
    axes.set_ylabel("share of epochs with H < 0.7")
    axes.legend(fontsize=8)
    save_figure(figure, path)


def transfer(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    """Draw false alerts and detections on each recording with the threshold of each other, for
    H.
    """
    figure, axes = new_figure(11.0, 5.2, columns=2)
    for panel, key in zip(axes, ("false_alert_share", "detection_share"), strict=True):
        share = {
            (row["fitted_on"], row["applied_to"]): row[key]
            for row in rows
            if row["statistic"] == "H" and row[key] is not None
        }
        grid = np.array(
            [
                [share.get((fitted_on, applied_to), np.nan) for applied_to in names]
                for fitted_on in names
            ]
        )
        panel.imshow(grid, vmin=0, vmax=1, cmap="Oranges" if key.startswith("false") else "Blues")
        for i, j in np.argwhere(~np.isnan(grid)).tolist():
            panel.text(
                j,
                i,
                f"{100 * grid[i, j]:.0f}",
                ha="center",
                va="center",
                fontsize=7,
                color="w" if grid[i, j] > 0.6 else "k",
            )
        panel.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=8)
        panel.set_yticks(range(len(names)), names, fontsize=8)
        panel.set_title(key.replace("_", " ").replace("share", "share, %"), fontsize=10)
        panel.set_xlabel("applied to")
    axes[0].set_ylabel("fitted on")
    save_figure(figure, path)


def dynamics(path: Path, rows: Sequence[Row]) -> None:
    """Draw genuine medians over the window's dynamics, a panel per recording of long windows
    (Section V-C).
    """
    names = [
        name
        for name in ("drive", "rtk-drive", "phone-car")
        if any(row["recording"] == name for row in rows)
    ]
    figure, axes = new_figure(9.0, 3.4, columns=max(len(names), 1))
    for panel, name in zip(np.atleast_1d(axes), names, strict=False):
        for statistic in FOUR:
            points = [
                (row["acceleration_mps2"], row["median"])
                for row in rows
                if (row["recording"], row["statistic"]) == (name, statistic)
            ]
            panel.plot(
                *zip(*points, strict=True), marker=".", color=COLOURS[statistic], label=statistic
            )
        panel.set_ylim(0.5, 1)
        panel.set_title(name, fontsize=10)
        panel.set_xlabel("rms acceleration, m/s²")
    np.atleast_1d(axes)[0].set_ylabel("median, genuine")
    np.atleast_1d(axes)[-1].legend(fontsize=8)
    save_figure(figure, path)


def draw(out: Path, findings: Findings) -> list[Picture]:
    """Draw all pictures of the sessions that are there into a folder."""
    return list(_drawn(out, findings))


def _drawn(out: Path, findings: Findings) -> Iterator[Picture]:
    for name, figure in (("drive", "Fig 7"), ("phone-car", "Fig 10"), ("iphone-3", "Fig 14")):
        if name in findings.sessions:
            session = findings.sessions[name]
            time_series(out / f"series-{name}", session)
            yield Picture(
                f"series-{name}",
                (
                    f"As {figure}, {name} ({session.log.about}): horizontal acceleration and yaw "
                    "rate, IMU and GNSS"
                ),
            )
    for name, figure in (("drive", "Fig 8"), ("phone-car", "Figs 11 and 13")):
        if name in findings.sessions:
            statistics(out / f"statistics-{name}", findings.values, [(name, "genuine")])
            yield Picture(
                f"statistics-{name}",
                f"As {figure}, {name}, genuine: the four statistics over {_window(findings, name)}",
            )
    meaconed = [
        key for key in _meaconed(findings) if key[0] in ("drive", "boston", "iphone-2", "zed-f9r-a")
    ]
    if meaconed:
        statistics(out / "statistics-meaconing", findings.values, meaconed[:4])
        yield Picture(
            "statistics-meaconing",
            "As Figs 9 and 12: GNSS of another run; for the drive, of another car",
        )
    if findings.long:
        delays(out / "delays", findings.tables["statistics"], findings.long)
        yield Picture(
            "delays", "Share of epochs with H below 0.7, by delay of the replay; 0 is genuine"
        )
    if len(findings.long) > 1:
        transfer(out / "transfer", findings.tables["transfer"], findings.long)
        yield Picture(
            "transfer",
            (
                "Thresholds on H fitted to one recording (rows: 1 % of genuine epochs below) and "
                "used on another (columns)"
            ),
        )
        dynamics(out / "dynamics", findings.tables["dynamics"])
        yield Picture(
            "dynamics", "Genuine medians by quintile of dynamics: steady cruise is on the left"
        )


def _window(findings: Findings, name: str) -> str:
    return f"{findings.sessions[name].window_s:g} s"


def _meaconed(findings: Findings) -> Sequence[tuple[str, str]]:
    pairs = dict.fromkeys(
        (name, case) for name, case, _ in findings.values if case.startswith("meacon")
    )
    first = {name: (name, case) for name, case in reversed(pairs)}
    return [first[name] for name in findings.sessions if name in first]
