"""Live view: a page on this computer that shows a run while it goes on, or a recorded one with a slider."""
