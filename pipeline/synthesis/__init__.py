"""Synthetic recordings of a solved design."""
