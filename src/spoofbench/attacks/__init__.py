"""The attack's contract, and the attacks that come with spoofbench."""

from spoofbench.attacks.contract import (
    Attack,
    HasAttackableSpan,
    attackable_span,
    draw_window,
    make_variant,
)

__all__ = ["Attack", "HasAttackableSpan", "attackable_span", "draw_window", "make_variant"]
