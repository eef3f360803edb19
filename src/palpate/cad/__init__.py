"""Geometry of CAD parts: readers of solids and drawings, stable states, cross sections.

Independent of rigs, recogniser and palpate's file formats; `palpate.rig` writes the results into object
models. Readers of file formats need extras and are imported only when such a file is read.
"""
