"""Options of the NMEA decoder."""

import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DecoderOptions:
    """What the decoder asks of a converter's options.

    Attributes:
        source: talker, such as ``GP``, of the one receiver to convert where a log holds several;
            satellites in view and in use are kept of all GNSS talkers.
    """

    source: str | None = None

    def __post_init__(self) -> None:
        if self.source is not None and not re.fullmatch("[A-Z]{2}", self.source):
            raise ValueError(
                f"source must be a talker of two capital letters such as 'GP', not {self.source!r}"
            )
