"""The workers' functions are in a module that they can import."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "work"))
