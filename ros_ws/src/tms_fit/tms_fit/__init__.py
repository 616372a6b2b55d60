"""Reads runs: strikes, least squares, Kalman filter and smoother, Figure 3B. Never imports the simulator."""

__version__ = "0.1.0"
