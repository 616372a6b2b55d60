"""Many strikes in one fit: shared numbers, heterogeneity, calibration of a bicycle."""
