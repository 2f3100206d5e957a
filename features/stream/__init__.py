"""From volts, a block at a time, to the slide at hand."""
