"""The report of a result: one HTML file that needs no network and says what every number means.

What draws it, :mod:`procedures.report.write`, is imported where a report is drawn: a daemon that only needs
how figures are rounded starts without plotly.
"""
