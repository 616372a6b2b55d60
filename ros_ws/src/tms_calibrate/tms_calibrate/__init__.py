"""Pooled fits of many strikes, calibration of bicycle parameters and their identifiability."""

__version__ = "0.1.0"
