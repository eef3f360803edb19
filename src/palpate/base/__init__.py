"""Small utilities that every layer may use: errors, vocabulary, plane geometry, files, entry points.

Nothing here knows the rest of palpate.
"""
