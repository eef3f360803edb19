"""The identification loop: grip, recognise, plan the next grip, until one answer is left."""
