"""Figs 7-12 and 15-23 of Lo et al. (2017) in kind, from the first simulated run, and Table 2 as a
picture.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spoofbench.arrays import Floats
from spoofbench_papers.figures import new_figure, save_figure
from spoofbench_papers.lo2017.approach import PHONE_HZ, RATE_HZ, Flights, stand_still
from spoofbench_papers.lo2017.cells import JUDGED, JUDGED_STRIDE, LITERAL, Outcomes
from spoofbench_papers.lo2017.ensemble import Flags, Spoofer, flags, spoofed
from spoofbench_papers.lo2017.tables import CASES, MONITORS, autocorrelation, crosscorrelation
from spoofbench_papers.reproduction import Picture

PHONE, GNSS, SPOOFER = "#3b6fb6", "#c8442e", "#222222"
_SHOWN_RUN = 0
_EXAMPLES: tuple[tuple[str, int, Spoofer, float], ...] = (
    ("fig15-18", 1, "repeat", 2.0),
    ("fig19-22", 2, "extrapolate & smooth", 0.5),
)


def draw(out: Path, flights: Mapping[int, Flights], found: Outcomes) -> list[Picture]:
    """Write all pictures and say what they show."""
    _accelerations(out, flights)
    _correlations(out, flights)
    _histogram(out, flights[2])
    _static(out)
    _dropout(out, flights[4])
    _table(out, found)
    pictures = [
        Picture(
            "table2",
            (
                f"Table 2: printed against simulated percentages, {JUDGED} and {LITERAL} samples; "
                "bars hold 95 % of the runs."
            ),
        ),
        Picture(
            "fig7-8",
            (
                "Figs 7 and 8 in kind: averaged vertical acceleration of accelerometer and "
                "receiver, approaches 1 and 2, simulated."
            ),
        ),
        Picture(
            "fig9-10",
            (
                "Figs 9 and 10 in kind: autocorrelation of approaches 1 and 2, cross-correlation "
                "of 2 with 1 and 3, simulated."
            ),
        ),
        Picture(
            "fig11",
            (
                "Fig 11 in kind: difference of the accelerations of approach 2 and the Gaussian of "
                "its mean and deviation, simulated."
            ),
        ),
        Picture(
            "fig12",
            (
                "Fig 12 in kind: 14 s at rest, not averaged, simulated; the two scales differ by a "
                "factor of 20."
            ),
        ),
    ]
    for figures, number, spoofer, delay_s in _EXAMPLES:
        _detection(out / figures, flights[number], spoofer, delay_s)
        attack = (
            f"{spoofer} by {delay_s:g} s, {JUDGED} samples, simulated; dotted and dashed: the "
            "monitors' 3 and 6 flags."
        )
        pictures.append(
            Picture(
                figures,
                (
                    f"Figs {figures[3:].replace('-', ' to ')} in kind: approach {number}, nominal "
                    f"and under {attack}"
                ),
            )
        )
    pictures.append(
        Picture(
            "fig23", "Fig 23 in kind: the lost epoch of approach 4, not gated and gated, simulated."
        )
    )
    return pictures


def _seconds(flights: Flights) -> Floats:
    return np.arange(len(flights.phone_mps2) - flights.start) / RATE_HZ


def _run(values: Any, flights: Flights) -> Any:
    return values[flights.start :, _SHOWN_RUN]


def _accelerations(out: Path, flights: Mapping[int, Flights]) -> None:
    figure, axes = new_figure(8.0, 5.0, rows=2)
    for panel, number in zip(axes, (1, 2), strict=True):
        flight = flights[number]
        panel.plot(
            _seconds(flight),
            _run(flight.phone_mps2, flight),
            color=PHONE,
            lw=0.9,
            label="accelerometer",
        )
        panel.plot(
            _seconds(flight), _run(flight.gnss_mps2, flight), color=GNSS, lw=0.9, label="GNSS"
        )
        panel.set_title(f"approach {number}", fontsize=9)
        panel.set_ylabel("m/s$^2$")
    axes[0].legend(loc="upper right", fontsize=8)
    axes[1].set_xlabel("time since the start of the approach, s")
    save_figure(figure, out / "fig7-8")


def _correlations(out: Path, flights: Mapping[int, Flights]) -> None:
    figure, (auto, cross) = new_figure(9.0, 3.6, columns=2)
    phones = {number: _run(flight.phone_mps2, flight) for number, flight in flights.items()}
    for number in (1, 2):
        values = autocorrelation(phones[number])[: 20 * RATE_HZ]
        auto.plot(np.arange(values.size) / RATE_HZ, values, label=f"approach {number}")
    auto.axhline(np.exp(-1), color="k", ls="--", lw=0.8, label="1/e")
    for number in (1, 3):
        values = crosscorrelation(phones[2], phones[number])
        cross.plot(
            (np.arange(values.size) - phones[2].size + 1) / RATE_HZ,
            values,
            lw=0.8,
            label=f"2 with {number}",
        )
    for panel, title in (
        (auto, "autocorrelation"),
        (cross, "cross-correlation over the autocorrelation of 2"),
    ):
        panel.set_xlabel("lag, s")
        panel.set_title(title, fontsize=9)
        panel.legend(fontsize=8)
    save_figure(figure, out / "fig9-10")


def _histogram(out: Path, flight: Flights) -> None:
    figure, panel = new_figure(6.0, 3.6)
    difference = _run(flight.phone_mps2 - flight.gnss_mps2, flight)
    mean, deviation = difference.mean(), difference.std(ddof=1)
    panel.hist(
        difference, bins=40, density=True, color=PHONE, alpha=0.6, label="accelerometer - GNSS"
    )
    x = np.linspace(mean - 4 * deviation, mean + 4 * deviation, 200)
    density = np.exp(-(((x - mean) / deviation) ** 2) / 2) / (deviation * np.sqrt(2 * np.pi))
    panel.plot(x, density, color="k", label=f"Gaussian, mean {mean:.3f}, deviation {deviation:.3f}")
    panel.set_xlabel("difference of the averaged accelerations, m/s$^2$")
    panel.set_ylabel("density, s$^2$/m")
    panel.legend(fontsize=8)
    save_figure(figure, out / "fig11")


def _static(out: Path) -> None:
    figure, axes = new_figure(7.0, 4.2, rows=2)
    phone, gnss = stand_still(14.0, seed=0)
    for panel, values, rate_hz, color, name in zip(
        axes,
        (phone, gnss),
        (PHONE_HZ, RATE_HZ),
        (PHONE, GNSS),
        ("accelerometer", "GNSS"),
        strict=True,
    ):
        panel.plot(np.arange(len(values)) / rate_hz, values[:, 0], color=color, lw=0.9)
        panel.set_title(f"{name}: deviation {values.std():.3f} m/s$^2$", fontsize=9)
        panel.set_ylabel("m/s$^2$")
    axes[0].set_ylim(-0.2, 0.2)
    axes[1].set_ylim(-4, 4)
    axes[1].set_xlabel("time, s")
    save_figure(figure, out / "fig12")


def _detection(path: Path, flight: Flights, spoofer: Spoofer, delay_s: float) -> None:
    """Accelerations; then difference, flags and their moving sums, nominal on the left and spoofed
    on the right.
    """
    figure, axes = new_figure(11.0, 8.0, columns=2, rows=4)
    time_s = _seconds(flight)
    for column, (name, shown) in enumerate(
        (
            ("nominal", flight.gnss_mps2),
            (f"{spoofer}, {delay_s:g} s", spoofed(flight.gnss_mps2, spoofer, delay_s)),
        )
    ):
        difference = flight.phone_mps2 - shown
        flagged = flags(difference[:, _SHOWN_RUN : _SHOWN_RUN + 1], flight.start, JUDGED_STRIDE)
        top, second, third, bottom = axes[:, column]
        top.plot(
            time_s, _run(flight.phone_mps2, flight), color=PHONE, lw=0.8, label="accelerometer"
        )
        top.plot(time_s, _run(flight.gnss_mps2, flight), color=GNSS, lw=0.8, label="GNSS")
        if column:
            top.plot(time_s, _run(shown, flight), color=SPOOFER, lw=0.8, label="spoofed GNSS")
        top.set_title(name, fontsize=9)
        top.legend(fontsize=7, loc="lower left", ncols=3)
        second.plot(time_s, _run(difference, flight), color="k", lw=0.8)
        _flag_rows(third, time_s, flagged)
        for counts, color, label in zip(
            flagged.counts(), (SPOOFER, GNSS), ("mean difference", "chi-square"), strict=True
        ):
            bottom.plot(time_s, counts[:, 0], color=color, lw=0.9, label=label)
        bottom.axhline(3, color="grey", ls=":", lw=0.8)
        bottom.axhline(6, color="grey", ls="--", lw=0.8)
        bottom.legend(fontsize=7, loc="upper right")
        bottom.set_ylim(-1, 51)
        bottom.set_xlabel("time since the start of the approach, s")
    for panel in axes[:3].flat:
        panel.tick_params(labelbottom=False)
    for panel, label in zip(
        axes[:, 0], ("m/s$^2$", "difference, m/s$^2$", "flags", "flags in 5 s"), strict=True
    ):
        panel.set_ylabel(label)
    for left, right in axes[:2]:
        low, high = (
            min(left.get_ylim()[0], right.get_ylim()[0]),
            max(left.get_ylim()[1], right.get_ylim()[1]),
        )
        left.set_ylim(low, high)
        right.set_ylim(low, high)
    save_figure(figure, path)


def _flag_rows(panel: Any, time_s: Floats, flagged: Flags) -> None:
    """The paper's heights: 1.5 for the mean-difference test, 1 for the chi-square test."""
    for test, height, color in (
        (flagged.mean_difference, 1.5, SPOOFER),
        (flagged.chi_square, 1.0, GNSS),
    ):
        panel.plot(time_s, np.where(test[:, 0], height, 0.0), color=color, lw=0.7)
    panel.set_ylim(-0.1, 1.8)


def _dropout(out: Path, flight: Flights) -> None:
    figure, panel = new_figure(7.0, 3.6)
    time_s = _seconds(flight)
    near = (time_s > 38) & (time_s < 52)
    for values, color, style, name in (
        (flight.phone_mps2, PHONE, "-", "accelerometer"),
        (flight.gnss_mps2, GNSS, "-", "GNSS"),
        (flight.gated_mps2, "k", ":", "GNSS, gated"),
    ):
        panel.plot(time_s[near], _run(values, flight)[near], color=color, ls=style, label=name)
    panel.set_xlabel("time since the start of approach 4, s")
    panel.set_ylabel("averaged acceleration, m/s$^2$")
    panel.legend(fontsize=8)
    save_figure(figure, out / "fig23")


def _table(out: Path, found: Outcomes) -> None:
    """Printed percentage across, simulated up, one panel per monitor; a table on the diagonal would
    be the printed one.
    """
    figure, axes = new_figure(10.0, 5.0, columns=2)
    for panel, monitor in zip(axes, MONITORS, strict=True):
        panel.plot([0, 100], [0, 100], color="grey", lw=0.8)
        for index, case in enumerate(CASES):
            for way, marker in ((JUDGED, "o"), (LITERAL, "x")):
                outcomes = [found[case.name, number, monitor, way] for number in (1, 2, 3, 4)]
                printed: Sequence[Any] = case.detection_pct[monitor]
                medians = [outcome.median_pct for outcome in outcomes]
                panel.plot(
                    printed,
                    medians,
                    marker,
                    color=f"C{index}",
                    ms=5,
                    label=case.name if way == JUDGED else None,
                )
                if way == JUDGED:
                    ends = [outcome.limits()[:2] for outcome in outcomes]
                    panel.vlines(
                        printed,
                        [low for low, _ in ends],
                        [high for _, high in ends],
                        color=f"C{index}",
                        lw=0.8,
                    )
        panel.set_title(f"{monitor} monitor (o {JUDGED}, x {LITERAL})", fontsize=9)
        panel.set_xlabel("printed, %")
    axes[0].set_ylabel("simulated, %")
    axes[0].legend(fontsize=7)
    save_figure(figure, out / "table2")
