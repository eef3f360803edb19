"""The command line: one module a command, its options, its progress and its exit codes."""
