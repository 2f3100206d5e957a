"""What `softslide check` looks for in a folder of recordings."""
