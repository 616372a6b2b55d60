"""Equations and figures of the supplement that only its reproduction needs.

Steady turns (chapter 5), JBike6's inertias (chapter 6), the two-mass skate in closed form (chapter 7), the
experimental bicycle (chapters 8 and 9), and figures of chapters 5 and 7. docs/reproduction.md lists them,
equation by equation.

Reference: Kooijman et al. 2011, supplement (SOM), doi 10.1126/science.1201959.
"""
