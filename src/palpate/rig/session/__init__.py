"""Sessions: the log of a run, its replay, and the environment that provides a run with its devices."""
