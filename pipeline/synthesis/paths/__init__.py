"""Contacts along any path: drawn, timed, and what the skin answers to them."""
