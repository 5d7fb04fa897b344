"""Convert recordings to and from the file formats of other programs.

A measurement needs none of these modules: it reads and writes RAW files alone. The modules here may import those of
``drivers.camera``; no driver imports them.
"""
