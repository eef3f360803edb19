"""Sessions: the log of a run, its replay, and the environment that a run takes its devices from."""
