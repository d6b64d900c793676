"""Measured tables: speed, accuracy."""
