"""Tracks a contact along any path: a bank of extended Kalman filters on the response map."""
