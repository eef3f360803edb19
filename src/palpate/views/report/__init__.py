"""Reports: self-contained HTML pages of a run, to be read, sent and printed."""
