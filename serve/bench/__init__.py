"""Cost of the runtime and of the live page."""
