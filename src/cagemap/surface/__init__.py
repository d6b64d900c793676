"""Triangulated surfaces, points on them, and the search for closest points."""
