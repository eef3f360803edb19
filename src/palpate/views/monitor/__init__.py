"""Tactile arrays on a terminal: taxel maps, lines and the screen of `palpate watch`."""
