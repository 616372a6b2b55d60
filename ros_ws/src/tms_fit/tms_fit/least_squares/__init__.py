"""Separable nonlinear least squares with noise models, robust losses and censored samples."""
