"""Batch evaluation of a bundle: read out, scored, held against the bounds, reported."""
