"""What a file may cost: every limit on files from outside, in one table.

Each is several times what a large useful file needs; together they keep whatever a file holds below 10 s
and 1 GB. docs/file-limits.md says the same for users.
"""

__all__ = [
    "CAD_BYTES",
    "DRAWN_NUMBERS",
    "DRAWN_PIECES",
    "FACETS",
    "JSON_BYTES",
    "LOG_BYTES",
    "LOG_LINES",
    "LOG_LINE_BYTES",
    "LOG_VALUES",
    "MEMBERS",
    "NESTING",
    "OUTLINES",
    "PARTS",
    "READING_BYTES",
    "READING_S",
    "READING_WALL_S",
    "RUNS_BYTES",
    "TABLE_KEYS",
    "TOML_BYTES",
    "UNCONFINED_BYTES",
    "VALUES",
]

MB = 1_000_000

TOML_BYTES = 1 * MB
"""A rig, calibration or references file; those of 16 fingers take 0.1 MB."""
JSON_BYTES = 32 * MB
"""An objects, contacts or scene file, or the record of a calibration; a leaning state takes 0.1 to 1 MB."""
LOG_BYTES = 320 * MB
"""A session's log, also unpacked; a minute takes 15 to 30 MB."""
RUNS_BYTES = 128 * MB
"""A file of a study's runs; 360,000 take that, and 700 MB of memory."""
CAD_BYTES = 64 * MB
"""A mesh, STEP file or drawing, also unpacked; 200,000 facets take 58 MB as ASCII STL."""

VALUES = 4_000_000
"""Numbers, texts, lists and tables in a JSON file, counted by commas and brackets."""
OUTLINES = 1_000
"""Outlines in one cross section, holes counted."""
TABLE_KEYS = 1_000
"""Keys in one table of a TOML or JSON file."""
NESTING = 64
"""Parts of a dotted key in TOML, blocks within blocks in DXF, elements within elements in SVG."""
LOG_LINES = 600_000
"""Lines in a log; 320 MB of a real one have 480,000."""
LOG_VALUES = 6_000_000
"""The same as `VALUES` in a log, lines of bytes left out; 320 MB of a real one have 4,800,000."""
LOG_LINE_BYTES = 4 * MB
"""A line of a log; the longest, with all interpretations of a grip, take 0.4 MB."""

FACETS = 500_000
"""Triangles in a mesh or STEP file."""
PARTS = 1_000
"""Bodies or parts in a CAD file."""
MEMBERS = 1_000
"""Files in a 3MF file, which is a ZIP archive."""
DRAWN_PIECES = 50_000
"""Entities or elements of a drawing, its blocks and copies unfolded."""
DRAWN_NUMBERS = 400_000
"""Numbers in the outlines of a drawing, its copies unfolded: two for each point."""

READING_S = 8.0
"""Processor time to read and check a CAD file or a large objects file, in a process of its own."""
UNCONFINED_BYTES = 100_000
"""Objects files up to this are read without such a process."""
READING_WALL_S = 60.0
"""Time on the clock for the same, where the computer is busy with something else."""
READING_BYTES = 768 * MB
"""Memory of that process."""
