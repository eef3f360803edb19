"""From CAD files to what rests on a table: solids and drawings in, stable states and cross sections out.

Knows no rig, no recogniser and no file format of ours; `palpate.rig` writes what is found into object models.
Readers of file formats live in extras and are imported only when a file of theirs is read.
"""
