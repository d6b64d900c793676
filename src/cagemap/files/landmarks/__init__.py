"""Landmarks, curves and symmetries in files."""
