"""The picture of a recognition or a plan: the table from above, with a panel. Values to SVG."""
