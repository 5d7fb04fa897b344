"""Reports as self-contained HTML files, without scripts and without network access; the same data, the same bytes.

Numbers come from results.json (``docs/results.md``), pictures and plots from the views, a limited number of them.
"""
