"""The identification loop: grip, recognise, plan the next grip, until there is one answer."""
