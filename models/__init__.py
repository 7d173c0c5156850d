"""Trained models shipped with the package."""
