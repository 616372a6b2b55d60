"""Residual tests, hypothesis tests, error budget and misspecification of a fit."""
