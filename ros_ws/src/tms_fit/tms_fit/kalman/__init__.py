"""Kalman filters and smoothers of the bicycle's state: one run as it is measured, and many runs at once."""
