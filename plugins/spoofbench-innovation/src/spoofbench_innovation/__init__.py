"""The innovation monitor of an INS/GNSS filter (Tanil et al. 2018), and the evaluation of it in two
papers.
"""

from spoofbench_innovation.monitor import InnovationMonitor

__all__ = ["InnovationMonitor"]
