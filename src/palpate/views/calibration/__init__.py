"""The report of a calibration: numbers, residuals and taxel gains. Values to HTML and SVG."""
