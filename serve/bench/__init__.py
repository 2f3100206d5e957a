"""What the runtime costs."""
