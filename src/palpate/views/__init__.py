"""Pictures, tables and text: from values to SVG, HTML and plain text. Independent of devices."""
