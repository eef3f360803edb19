"""Moving fingers: the hand, guarded moves and what a touch says."""
