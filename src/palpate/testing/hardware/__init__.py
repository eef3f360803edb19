"""Tests of a real rig: `python -m palpate.testing.hardware --rig FILE`, from harmless to moving.

Needs pytest (`pip install palpate[testing]`). `docs/first-day.md` says in which order a new rig is measured.
"""
