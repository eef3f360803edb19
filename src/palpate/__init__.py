"""palpate: tells which known object lies on the table, how it rests and where, from a few touches."""
