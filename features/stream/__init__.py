"""From volts, a block at a time, to the window of a slide."""
