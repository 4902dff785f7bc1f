"""The report of a result: one HTML file that needs no network and says what every number means."""

from procedures.report.write import write_report

__all__ = ["write_report"]
