"""The report of a run: one HTML file that holds all it shows, without scripts, without a network.

``render_report`` is a function of its data alone: the same data give the same bytes. Every number in the
text comes from results.json (see ``docs/results.md``); pictures and plots come from the views. Both are bounded: a page
of thousands of poses is no larger than its tables make it.
"""

from bench.report.choice import pictured_poses
from bench.report.html import ReportData, printed_text, render_report
from bench.report.pictures import ViewPicture

__all__ = ["ReportData", "ViewPicture", "pictured_poses", "printed_text", "render_report"]
