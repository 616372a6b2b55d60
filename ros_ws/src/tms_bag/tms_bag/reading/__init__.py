"""Bags read: what is where in their files, and messages decoded column by column."""
