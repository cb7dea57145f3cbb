"""Estimation theory on matrices: it knows no model and no drone."""
