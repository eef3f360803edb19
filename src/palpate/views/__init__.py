"""Pictures, tables and sentences: from values to SVG, HTML and text. Knows no device."""
