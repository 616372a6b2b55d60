"""Logs of other loggers: CSV in, CSV out."""
