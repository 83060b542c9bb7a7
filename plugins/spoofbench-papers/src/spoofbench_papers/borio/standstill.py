"""Borio, Section V-A: do GNSS and IMU stand still at the same times?"""

from collections.abc import Sequence
from typing import get_args

import numpy as np
from spoofbench_correlation.series import receiver_velocity
from spoofbench_correlation.zero_velocity import Contradiction, ZeroVelocity

from spoofbench.arrays import Bools
from spoofbench.detector import detect
from spoofbench.navigation.imu import Standstill, is_stationary
from spoofbench_papers.borio.recordings import FieldSession
from spoofbench_papers.borio.statistics import Row, Series, cases, window_motion


def parked(session: FieldSession, series: Series) -> Bools:
    """Return whether each value of a series, ``(n,)``, is of a window in which the receiver stands
    still throughout.
    """
    time_s, _, _, slow = window_motion(session)
    return np.asarray(slow[np.searchsorted(time_s, series.time_s)] == 1)


def contradictions(sessions: Sequence[FieldSession]) -> list[Row]:
    """Return contradicted seconds per minute over each session, genuine and under each attack; null
    where standstill is not known.
    """
    rows = []
    for session in sessions:
        if not session.inertial:
            continue
        for case, recording in cases(session, sessions):
            for kind in get_args(Contradiction):
                detector = ZeroVelocity(
                    kind, window_s=recording.span.duration_s, min_share=0.5, threshold_per_min=1.0
                )
                decisions = detect(detector, recording)
                known = decisions.available.size > 0 and bool(decisions.available[-1])
                per_min = float(decisions.score[-1]) if known else None
                rows.append(
                    {"recording": session.name, "case": case, "kind": kind, "per_min": per_min}
                )
    return rows


def at_rest(sessions: Sequence[FieldSession]) -> list[Row]:
    """Return, of the epochs at which a receiver stands still, the shares that the IMU's two limits
    each find still; null where unknown.
    """
    rows = []
    for session in sessions:
        if not session.inertial:
            continue
        velocity = receiver_velocity(session.recording.primary("gnss/pvt"))
        slow = velocity.speed_mps < ZeroVelocity.speed_mps
        time_ns = velocity.time_ns[1:][slow[1:] & slow[:-1]]
        shares = {}
        for name, rest in (
            ("force", Standstill(rate_rms_radps=np.inf)),
            ("rate", Standstill(force_std_mps2=np.inf)),
        ):
            still = is_stationary(session.recording.primary("imu"), time_ns, rest)
            known = still[~np.isnan(still)]
            shares[f"{name}_still_share"] = float(known.mean()) if known.size else None
        rows.append({"recording": session.name, "epochs": time_ns.size, **shares})
    return rows
