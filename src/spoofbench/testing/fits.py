"""What every detector that learns must keep, besides what every detector must: laws of
:meth:`spoofbench.detector.Trainable.fit`.

A detector that cannot be fitted on the simulated drives says so by ``NotApplicable``, and passes.
"""

import pickle
from collections.abc import Sequence
from functools import cache

from spoofbench.detector import Detector, Labelled, Trainable, learns_from_attacks
from spoofbench.errors import NotApplicable
from spoofbench.recording import Recording, attacked_intervals
from spoofbench.schema import split_topic
from spoofbench.testing.detector_cases import (
    DetectorUnderTest,
    fingerprint,
    private,
    process_state,
    quiet,
)
from spoofbench.testing.kit import global_seed, require
from spoofbench.testing.recordings import drive, spoofed_drive

DURATION_S = 240.0
SEEDS = (11, 12)


@cache
def calibration() -> tuple[tuple[Recording, ...], tuple[Labelled, ...]]:
    """Return clean drives, and attacked ones with their intervals, all of them blind."""
    attacked = [spoofed_drive(seed, DURATION_S) for seed in SEEDS]
    return (
        tuple(drive(seed, DURATION_S).blind() for seed in SEEDS),
        tuple(Labelled(one.blind(), attacked_intervals(one)) for one in attacked),
    )


def fit(detector: Trainable) -> Trainable | None:
    """Fit a detector as the harness does: on recordings of the kinds that it declares, attacked
    ones only if it asks for them. None where it cannot be fitted.
    """
    clean, attacked = calibration()
    return _fit(detector, clean, attacked if learns_from_attacks(detector) else ())


def _fit(
    detector: Trainable, clean: Sequence[Recording], attacked: Sequence[Labelled]
) -> Trainable | None:
    with quiet():
        try:
            return detector.fit(
                [_declared(detector, one) for one in clean],
                [Labelled(_declared(detector, one.recording), one.attacked) for one in attacked],
            )
        except NotApplicable:
            return None


def _declared(detector: Detector, recording: Recording) -> Recording:
    kinds = {*detector.requires, *detector.uses}
    others = [topic for topic in recording if split_topic(topic)[1] not in kinds]
    return private(recording.replace(dict.fromkeys(others)))


def fits_a_copy(subject: DetectorUnderTest) -> None:
    """Fitting gives a detector of the same type that pickles, and leaves the one that is fitted,
    the recordings and the process as they are.
    """
    detector = subject.detector
    if not isinstance(detector, Trainable):
        return
    before, recordings = pickle.dumps(detector), [fingerprint(one) for one in calibration()[0]]
    with global_seed(11):
        state = process_state()
        fitted = fit(detector)
        for name, value in process_state().items():
            require(value == state[name], f"fit() changes {name} of the process")
    require(pickle.dumps(detector) == before, "fit() alters the detector that it is called on")
    after = [fingerprint(one) for one in calibration()[0]]
    require(after == recordings, "fit() alters a recording")
    if fitted is not None:
        require(
            type(fitted) is type(detector),
            f"fit() of a {type(detector).__name__} returns a {type(fitted).__name__}",
        )
        pickle.loads(pickle.dumps(fitted))


def fits_alike_twice(subject: DetectorUnderTest) -> None:
    """Fitting again, or a copy of it, gives the same pickle, whatever the state of the global
    random generators.
    """
    detector = subject.detector
    if not isinstance(detector, Trainable):
        return
    pickles = []
    for seed, one in enumerate((detector, detector, pickle.loads(pickle.dumps(detector)))):
        with global_seed(seed):
            pickles.append(pickle.dumps(fit(one)))
    require(
        len(set(pickles)) == 1,
        "fitted twice on the same recordings, it differs: draw chance from a generator that a "
        "field seed starts",
    )


def learns_only_what_it_declares(subject: DetectorUnderTest) -> None:
    """Without ``learns_from_attacks`` it is fitted on clean recordings alone, and attacked ones
    make no difference.
    """
    detector = subject.detector
    if not isinstance(detector, Trainable) or learns_from_attacks(detector):
        return
    clean, attacked = calibration()
    require(
        pickle.dumps(_fit(detector, clean, ())) == pickle.dumps(_fit(detector, clean, attacked)),
        "it learns from attacked recordings: declare so by learns_from_attacks = True",
    )
