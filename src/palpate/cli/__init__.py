"""The command line: one module per group of commands, with options, progress and exit codes."""
