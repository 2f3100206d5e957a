"""Figures of the documents: where they stand, and measuring them anew."""
