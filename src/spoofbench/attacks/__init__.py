"""The attack's contract, and the attacks that come with spoofbench."""

from spoofbench.attacks.contract import Attack, Supplied, draw_window, falsify, supply_of

__all__ = ["Attack", "Supplied", "draw_window", "falsify", "supply_of"]
