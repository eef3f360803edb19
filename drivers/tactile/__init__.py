"""Tactile arrays: protocol, host driver and contact extractor. Bytes in, contact patches out."""
