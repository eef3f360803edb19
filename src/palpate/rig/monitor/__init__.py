"""Monitoring of tactile arrays, live or from a recorded session, without moving anything."""
