"""Small tools that every layer may use: errors, published words, plane geometry, files, entry points.

Nothing here knows the rest of palpate.
"""
