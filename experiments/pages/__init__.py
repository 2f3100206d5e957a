"""Self-contained HTML pages: their look in light and dark, and figures drawn into them."""
