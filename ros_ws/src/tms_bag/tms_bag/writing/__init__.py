"""Bags written, whole or not there at all; unfinished ones repaired."""
