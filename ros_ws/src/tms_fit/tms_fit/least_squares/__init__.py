"""Least squares by variable projection: what the bicycle predicts, the noise, the outliers, the answer."""
