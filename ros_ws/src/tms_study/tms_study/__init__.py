"""What needs both sides, simulator and estimators. Nothing imports this package."""

__version__ = "0.1.0"
