"""The attack's contract, and the attacks that come with spoofbench."""
