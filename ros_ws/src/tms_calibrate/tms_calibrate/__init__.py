"""Many strikes in one fit: pooled parameters, calibration of a bicycle, identifiability."""

__version__ = "0.1.0"
