"""Every model side by side on the same recordings."""
