"""Live view: a local web page that shows a run in progress, or a recorded one with a slider."""
