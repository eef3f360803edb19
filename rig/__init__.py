"""Running the bench: what joins drivers, recogniser and configuration, and the command line on top.

The only layer that knows all others. `bench` is the composition root, `hand` and `closing` move fingers,
`identify` is the loop from an untouched table to a verdict, `session` logs it, `report` and `picture` show
it, `cli` is what users start.
"""
