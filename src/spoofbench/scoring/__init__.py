"""Scores: what a detector's decisions are worth against the truth.

:mod:`.grid` puts decisions and truth on one grid of epochs, :mod:`.metrics` says what a detector
did there, :mod:`.calibration` at which factor its thresholds keep a false-alert rate,
:mod:`.statistics` what that tells with which certainty, :mod:`.score` scores a results folder and
:mod:`.leaderboard` ranks its detectors.

Two conventions of Lo et al. (2017), Table 2, to keep in mind beside these scores:

- Its percentages count unavailable epochs as missed, as ``detection_pct`` does.
- Its time to first detection is one epoch longer than first alert minus start, which is ``ttfd_s``:
  ``(k_first - k_on + 1) dt``, so that an alert at the first spoofed epoch has dt instead of 0.
"""
