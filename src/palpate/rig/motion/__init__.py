"""Motion of fingers: the hand, guarded moves and the evaluation of touches."""
