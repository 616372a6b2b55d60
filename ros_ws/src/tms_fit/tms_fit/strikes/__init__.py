"""Strikes found in rates, sample by sample, each with its reasons."""
