"""Synchronisation, strike tracking and live fits of samples in the order of their arrival."""
