"""Kalman filters and smoothers on the sampled bicycle."""
