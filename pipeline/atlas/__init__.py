"""The response atlas of a sensor design: solved, stored, interpolated."""
