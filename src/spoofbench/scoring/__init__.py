"""Scores: what a detector's decisions are worth against the truth.

Four floors: :mod:`.grid` puts decisions and truth on one grid of epochs, :mod:`.measures` are the definitions,
:mod:`.folder` scores a results folder, :mod:`.ranking` makes its leaderboard.

Conventions that differ from Lo et al. (2017), Table 2, or agree with it where one might not expect so:

- Unavailable epochs of an attack count as missed, as in the table's percentages.
- Time to first detection is first alert minus start of the attack, so an alert at the first spoofed epoch has
  0 s. The table's is one epoch longer: ``(k_first - k_on + 1) dt``.
"""
