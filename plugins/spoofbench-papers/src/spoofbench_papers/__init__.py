"""Papers on GNSS spoofing beside ours, and the integrity of an innovation monitor of one's own.

``spoofbench reproduce`` and ``spoofbench integrity`` come from here. A paper is a module that keeps
:class:`spoofbench_papers.reproduction.Reproduction` and has a line in
:data:`spoofbench_papers.reproduction.PAPERS`.
"""
