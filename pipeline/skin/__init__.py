"""The skin's mechanics: inflated, with boards cast in, under a sliding indenter."""
