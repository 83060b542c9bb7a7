"""The attacks that come with spoofbench keep the laws of the public kit."""

from typing import Any

from spoofbench.testing import check_attack


@check_attack("replay")
def test_replay(check: Any) -> None:
    check()


@check_attack("replay", delay_s=15.0)
def test_replay_of_a_moment_ago(check: Any) -> None:
    check()


@check_attack("repeat-back")
def test_repeat_back(check: Any) -> None:
    check()


@check_attack("meacon", separation_s=5.0)
def test_meacon(check: Any) -> None:
    check()


@check_attack("meacon", resample=True)
def test_meacon_resampled(check: Any) -> None:
    check()


@check_attack("extrapolate")
def test_extrapolate(check: Any) -> None:
    check()


@check_attack("extrapolate-smooth")
def test_extrapolate_smooth(check: Any) -> None:
    check()


@check_attack("zero-acceleration")
def test_zero_acceleration(check: Any) -> None:
    check()


@check_attack("zero-acceleration", strength=0.5)
def test_half_the_acceleration(check: Any) -> None:
    check()


@check_attack("drag-off")
def test_drag_off(check: Any) -> None:
    check()


@check_attack("drag-off", rate_mps=0.2, ramp_s=0.0, direction_deg=90.0, vertical_share=0.5)
def test_drag_off_upwards(check: Any) -> None:
    check()
