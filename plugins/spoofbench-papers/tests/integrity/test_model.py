"""The error model of the evaluation is that of the detector ``innovation``."""

import numpy as np
from spoofbench_innovation import error_model
from spoofbench_papers.integrity import model as integrity


def test_the_states_are_those_of_the_integrity_evaluation() -> None:
    names = ("POSITION", "VELOCITY", "ATTITUDE", "ACCEL_BIAS", "GYRO_BIAS")
    assert [getattr(error_model, name) for name in names] == [
        getattr(integrity, name) for name in names
    ]
    assert integrity.INERTIAL_STATES == error_model.STATES
    level = error_model.dynamics(np.eye(3)[None], np.array([[0, 0, -9.80665]]), 3600.0)
    np.testing.assert_array_equal(level[0], integrity.inertial_dynamics(3600.0, 3600.0))
