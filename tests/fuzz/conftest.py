"""The benchmarks' inputs and laws, which are not installed, and what workers import."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parent / "work"))
