"""Borio, Figs 7 to 14 and Section V in kind: on a car, on other cars and on phones whose logs are
there.
"""

from pathlib import Path

from spoofbench_papers.borio import pictures
from spoofbench_papers.borio.cells import Findings, cells
from spoofbench_papers.borio.discussion import discussion_cells
from spoofbench_papers.borio.recordings import FieldSession, sessions
from spoofbench_papers.borio.standstill import at_rest, contradictions
from spoofbench_papers.borio.statistics import (
    Row,
    all_values,
    dynamics,
    noisy_gyro,
    settings,
    summaries,
    transfer,
)
from spoofbench_papers.figures import save_table
from spoofbench_papers.reproduction import Progress, Reproduced

TITLE = "Borio: GNSS/INS verification by correlation, in kind"
PAPER = (
    "D. Borio: An Experimental Evaluation of GNSS/INS Verification Strategies for Vehicular "
    "Applications."
)

NOTES = (
    (
        "The paper's data are not public and it prints no table: its numbers are the bounds 0.8, "
        "0.6 and 0.7 that the text reads off "
        "the figures, and the window of 120 s. All recordings here are others: what holds on them "
        "holds in kind."
    ),
    (
        "The lag of each receiver is taken out: 0.34 s is what the drive's reference says of it; "
        "elsewhere it is what makes the genuine "
        "median of H greatest, which flatters the genuine values (settings.parquet has them with "
        "the lag left in), or 0 where a "
        "recording is short."
    ),
    (
        "All recordings are brought to 1 Hz. A receiver without velocity has the differences of "
        "its positions, one with speed alone the "
        "course of its positions (recordings.parquet). Windows are 120 s, and shorter where a "
        "recording holds less than two; cells "
        "and pictures that compare recordings keep to those of 120 s."
    ),
    (
        "Positions of the three iPhone trips look matched to a map: they turn corners in a second "
        "and at times step back, which shows as "
        "spikes of GNSS alone, the ones that Section V-B is about."
    ),
    (
        "The ZED-F9R logs couple GNSS with the very IMU, which the paper avoids, and hold one "
        "inertial sample a second: their genuine "
        "values say little either way. Solutions of phones may be fused too. The two runners hold "
        "their phones in the hand, and "
        "the phone of phone-car is moved at about 330 s, while the car stands."
    ),
    (
        "An epoch is no sample of its own, since windows overlap: intervals are of 1000 draws of "
        "blocks of one window."
    ),
    (
        "Of Fig 7 the loops in a roundabout, and of Fig 13 the drive of Fig 10 seen by a second "
        "IMU, have no counterpart in these recordings."
    ),
    (
        "Cells that begin with 'check' hold what the project expects of the drive; they are no "
        "numbers of the paper's."
    ),
)


def reproduce(out: Path, data: Path | None, quick: bool, progress: Progress) -> Reproduced:
    """Write all tables and pictures; ``data`` holds the logs of further vehicles, without which the
    drive stands alone.
    """
    found, left_out = sessions(data, quick, lambda share: progress(0.5 * share))
    with_imu = [session for session in found if session.inertial]
    values, made = all_values(found, lambda share: progress(0.5 + 0.2 * share))
    by_name = {session.name: session for session in found}
    drive = by_name.get("drive")
    tables = {
        "recordings": [_described(session) for session in found],
        "cases": made,
        "statistics": summaries(values, by_name),
        "transfer": transfer(values),
        "settings": settings(with_imu),
        "gyro_noise": noisy_gyro(drive) if drive else [],
        "dynamics": dynamics(with_imu, values),
        "contradictions": contradictions(found),
        "at_rest": at_rest(found),
    }
    progress(0.85)
    for name, rows in tables.items():
        save_table(
            {key: [row[key] for row in rows] for key in (rows[0] if rows else ())},
            out / f"{name}.parquet",
        )
    findings = Findings(by_name, values, tables)
    alone = (
        []
        if len(found) > 1
        else ["The logs of other vehicles are not there: what needs them is left out."]
    )
    return Reproduced(
        [*cells(findings), *discussion_cells(findings)],
        pictures.draw(out, findings),
        [*NOTES, *left_out, *alone],
    )


def _described(session: FieldSession) -> Row:
    return {
        "recording": session.name,
        "about": session.log.about,
        "group": session.log.group,
        "velocity": session.velocity,
        "inertial": session.inertial or None,
        "lag_s": session.lag_s if session.inertial else None,
        "window_s": session.window_s,
        "duration_s": session.recording.span.duration_s,
    }
