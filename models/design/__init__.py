"""What to record, and where to put the accelerometers."""
