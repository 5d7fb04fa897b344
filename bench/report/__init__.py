"""Reports as self-contained HTML files, without scripts and without network access.

``render_report`` depends on its data alone: the same data give the same bytes. Every number in the text comes from
results.json (see ``docs/results.md``); images and plots come from the views. The number of images and of drawn stars
is limited, so that the page of a run with thousands of poses stays small.
"""
