"""Commands that examine a bench: `find-port`, `scan`, `check`, `stop`."""
