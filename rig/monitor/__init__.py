"""Reading tactile arrays continuously, live or from a recorded session, without moving anything."""
