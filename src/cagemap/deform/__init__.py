"""Elastic fit: deform the target onto the source."""
