"""Study: how well a rig tells a catalogue apart, by simulated identifications."""
