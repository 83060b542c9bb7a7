"""Lo et al. (2017) Table 2 as printed: percentages of the approach and times to first detection,
None for N/A.
"""

from dataclasses import dataclass

from spoofbench_acceleration.statistics import Executive

from spoofbench_papers.lo2017.ensemble import Spoofer

Four = tuple[float | None, float | None, float | None, float | None]


@dataclass(frozen=True, slots=True)
class Case:
    """A row of Table 2: the spoofer, how late it knows, and by monitor what is printed for
    approaches 1 to 4.
    """

    name: str
    spoofer: Spoofer
    delay_s: float
    detection_pct: dict[Executive, Four]
    ttfd_s: dict[Executive, Four]


CASES = (
    Case(
        "nominal", "nominal", 0.0,
        {"simple": (0, 0, 0, 0), "multi": (0, 0, 0, 3.7)},
        {"simple": (None, None, None, None), "multi": (None, None, None, 44.9)},
    ),
    Case(
        "zero acceleration", "zero", 0.0,
        {"simple": (22.5, 35.5, 19.7, 22.4), "multi": (28.7, 49.4, 44.7, 35.6)},
        {"simple": (53.3, 11.3, 0.5, 1.0), "multi": (53.3, 10.6, 0.5, 0.7)},
    ),
    Case(
        "repeat 0.5 s", "repeat", 0.5,
        {"simple": (0, 0, 0, 0), "multi": (14.2, 50.3, 18.0, 24.4)},
        {"simple": (None, None, None, None), "multi": (32.3, 8.4, 12.5, 2.7)},
    ),
    Case(
        "extrapolate 0.5 s", "extrapolate", 0.5,
        {"simple": (0.9, 0, 0, 0), "multi": (99.7, 99.4, 99.5, 99.3)},
        {"simple": (48.8, None, None, None), "multi": (0.7, 0.7, 0.7, 0.9)},
    ),
    Case(
        "extrapolate & smooth 0.5 s", "extrapolate & smooth", 0.5,
        {"simple": (14.8, 17.9, 4.3, 13.3), "multi": (23.8, 49.1, 37.3, 27.8)},
        {"simple": (53.2, 14.6, 92.4, 55.3), "multi": (42.0, 10.7, 9.9, 12.9)},
    ),
    Case(
        "repeat 2 s", "repeat", 2.0,
        {"simple": (28.2, 41.2, 41.4, 33.4), "multi": (49.5, 84.3, 84.4, 68.4)},
        {"simple": (46.8, 11.2, 0.6, 3.6), "multi": (3.4, 1.0, 0.6, 2.6)},
    ),
    Case(
        "extrapolate 2 s", "extrapolate", 2.0,
        {"simple": (97.6, 99.7, 99.8, 98.5), "multi": (99.7, 99.7, 99.8, 99.5)},
        {"simple": (1.9, 0.4, 0.4, 1.9), "multi": (0.7, 0.4, 0.4, 0.7)},
    ),
    Case(
        "extrapolate & smooth 2 s", "extrapolate & smooth", 2.0,
        {"simple": (28.7, 40.9, 25.6, 30.8), "multi": (40.4, 70.6, 67.61, 64.2)},
        {"simple": (47.0, 11.2, 7.3, 6.3), "multi": (28.9, 9.5, 6.6, 6.3)},
    ),
)  # fmt: skip
