"""Pictures and listings of a file's object models: cards, height ladders, twins."""
