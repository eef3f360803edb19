"""Study: how well a rig distinguishes a catalogue, by simulated identifications."""
