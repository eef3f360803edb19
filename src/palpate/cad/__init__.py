"""Geometry of CAD parts: readers of solids and drawings, stable states, cross sections.

Knows no rig, no recogniser and no file format of ours; `palpate.rig` writes what is found into object models.
Readers of file formats live in extras and are imported only when a file of theirs is read.
"""
