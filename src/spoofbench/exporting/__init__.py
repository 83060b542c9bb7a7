"""Recordings for other programs: Parquet, CSV, GPX, or a table laid out by a mapping."""

from spoofbench.exporting.files import export, export_by_mapping

__all__ = ["export", "export_by_mapping"]
