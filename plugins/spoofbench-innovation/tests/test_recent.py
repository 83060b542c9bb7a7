"""What is remembered: the right thing, of bounded size."""

from hypothesis import given
from hypothesis import strategies as st
from spoofbench_innovation.recent import Recent, Same

from spoofbench.testing import drive


@given(st.lists(st.integers(0, 9), max_size=40), st.integers(0, 30))
def test_results_are_right_and_bounded(keys: list[int], limit: int) -> None:
    made: list[int] = []

    def make(key: int) -> bytes:
        made.append(key)
        return bytes(key)

    recent = Recent(limit, len)
    for place, key in enumerate(keys):
        before = len(made)
        assert recent.get(key, lambda key=key: make(key)) == bytes(key)
        assert sum(map(len, recent._kept.values())) <= max(limit, key)
        if place and keys[place - 1] == key:
            assert len(made) == before


def test_equal_tables_are_different_keys() -> None:
    """Comparing them would cost more than it saves."""
    one, other = (drive(0, 60.0).primary("imu") for _ in range(2))
    assert Same(one) == Same(one)
    assert hash(Same(one)) == hash(Same(one))
    assert Same(one) != Same(other)
