"""The public API: what `import palpate` offers, and what the command line calls. See docs/python.md."""
