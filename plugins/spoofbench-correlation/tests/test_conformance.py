"""The plugins keep the contract, as the public kit tells it."""

from collections.abc import Callable

from spoofbench.testing import check_detector


@check_detector("correlation")
def test_defaults(check: Callable[[], None]) -> None:
    check()


@check_detector(
    "correlation", statistic="M_acc", window_s=30, lag_s=0.3, median_filter=3, gravity="constant"
)
def test_norms_of_acceleration(check: Callable[[], None]) -> None:
    check()


@check_detector("correlation", statistic="M", window_s=20, adaptive=True, gravity="descent")
def test_norms_with_descent(check: Callable[[], None]) -> None:
    check()


@check_detector("zero-velocity", window_s=30, lag_s=0.3)
def test_zero_velocity(check: Callable[[], None]) -> None:
    check()
