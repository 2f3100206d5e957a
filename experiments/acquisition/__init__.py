"""Recording in a lab: which slides to take, and taking them into a folder of recordings."""
