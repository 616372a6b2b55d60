"""Samples as they come: live, replayed and offline go through the same classes."""
