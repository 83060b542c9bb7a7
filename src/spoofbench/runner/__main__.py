"""Entry of the server process: ``python -m spoofbench.runner <control descriptor> <parent>``."""

import sys

from spoofbench.runner.server import main

main(int(sys.argv[1]), int(sys.argv[2]))
