"""What making data costs, beside a foreign solver."""
